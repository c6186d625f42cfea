// Numbers in the 3D view: each on that side of its point where it covers no other, or left out until the view is turned.
const labelSides = ["top center", "bottom center", "middle right", "middle left", "top right", "bottom right", "top left", "bottom left"];

const projected = (plot) => {
  const scene = plot._fullLayout.scene?._scene;
  const params = scene?.glplot?.cameraParams;
  if (!params || !scene.dataScale) return null;
  const times = (m, v) => [0, 1, 2, 3].map((row) => m[row] * v[0] + m[row + 4] * v[1] + m[row + 8] * v[2] + m[row + 12] * v[3]);
  // The legend takes a part of the figure.
  const { width, height } = (scene.container ?? plot).getBoundingClientRect();
  return (x, y, z) => {
    const point = [x, y, z].map((value, axis) => value * scene.dataScale[axis]);
    const clip = times(params.projection, times(params.view, times(params.model, [...point, 1])));
    return [((1 + clip[0] / clip[3]) * width) / 2, ((1 - clip[1] / clip[3]) * height) / 2];
  };
};

const labelBox = ([x, y], text, side) => {
  const [width, height, beside] = [7 * text.length + 4, 14, 10], [up, across] = side.split(" ");
  const left = across === "center" ? x - width / 2 : across === "right" ? x + beside : x - beside - width;
  const top = up === "middle" ? y - height / 2 : up === "top" ? y - beside - height : y + beside;
  return [left, top, left + width, top + height];
};

const overlap = (a, b) => a[0] < b[2] && b[0] < a[2] && a[1] < b[3] && b[1] < a[3];

// Texts and their sides for each trace with numbers, as the view is now.
const placeLabels = (plot, texts) => {
  const at = projected(plot);
  if (!at) return null;
  const points = [];
  texts.forEach((all, trace) => all.forEach((text, n) => {
    const { x, y, z } = plot.data[trace];
    points.push({ trace, n, text, at: at(x[n], y[n], z[n]) });
  }));
  const taken = points.map(({ at: [x, y] }) => [x - 4, y - 4, x + 4, y + 4]);
  const result = new Map([...texts.keys()].map((trace) => [trace, { text: [], side: [] }]));
  points.forEach(({ trace, text, at }, own) => {
    const isFree = (side) => {
      const box = labelBox(at, text, side);
      return taken.every((other, n) => n === own || !overlap(box, other));
    };
    const side = labelSides.find(isFree);
    if (side) taken.push(labelBox(at, text, side));
    result.get(trace).text.push(side ? text : "");
    result.get(trace).side.push(side ?? labelSides[0]);
  });
  return result;
};

const keepLabelsApart = (plot) => {
  const texts = new Map();
  plot.data.forEach((trace, n) => { if (/text/.test(trace.mode ?? "")) texts.set(n, [...trace.text]); });
  let timer = 0;
  const place = () => {
    const placed = placeLabels(plot, texts);
    if (!placed) return;
    const traces = [...placed.keys()], of = (key) => traces.map((trace) => placed.get(trace)[key]);
    // A list of one or two sides would be taken for one offset of all.
    const sides = of("side").map((sides) => [...sides, ...Array(Math.max(0, 3 - sides.length)).fill(labelSides[0])]);
    Plotly.restyle(plot, { text: of("text"), textposition: sides }, traces);
  };
  const soon = () => { clearTimeout(timer); timer = setTimeout(place, 150); };
  if (texts.size) { plot.on("plotly_relayout", soon); addEventListener("resize", soon); soon(); }
};
