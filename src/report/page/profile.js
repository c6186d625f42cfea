// The figure of one profile: data, fitted curve, pulses with error bars, and what the curve leaves in standard errors.
// The vertical axis is asinh(v / noise): linear within the noise, logarithmic above it.
const profileFigure = (record, isLinear, colour) => {
  const finite = (values) => values.filter((value) => value !== null);
  const sorted = finite(record.error).sort((a, b) => a - b);
  const largest = Math.max(...finite(record.mean).map(Math.abs), 1e-30);
  const noise = sorted[sorted.length >> 1] || largest * 1e-3;
  const place = (value) => (value === null ? null : isLinear ? value : Math.asinh(value / noise));
  const all = (values) => values.map(place);
  const edge = (side) => record.mean.map((mean, n) => (record.error[n] === null ? null : place(mean + side * 2 * record.error[n])));
  const [data, fit, ink] = [colour("--visible"), colour("--hidden"), colour("--pale")];
  const line = (x, y, name, look) => ({ type: "scatter", mode: "lines", x, y, name, ...look });
  const skip = { hoverinfo: "skip", showlegend: false };
  const traces = [
    line(record.time, edge(-1), "", { line: { width: 0 }, ...skip }),
    line(record.time, edge(1), "", { line: { width: 0 }, fill: "tonexty", fillcolor: data + "44", ...skip }),
    line(record.time, all(record.mean), "data", { line: { color: data, width: 1.2 }, customdata: record.mean, hovertemplate: "%{x:,.0f} ps: %{customdata:.4~g} " + record.unit + "<extra>data</extra>" }),
  ];
  if (record.fit) traces.push(line(record.time, all(record.fit), "fitted curve", { line: { color: fit, width: 1.6 }, customdata: record.fit, hovertemplate: "%{x:,.0f} ps: %{customdata:.4~g} " + record.unit + "<extra>curve</extra>" }));
  const words = ["no path", "1st bounce", "2nd bounce", "3rd bounce", "4th bounce and later"];
  words.forEach((name, bounces) => {
    const pulses = record.pulses.filter((pulse) => pulse.bounces === bounces);
    if (!pulses.length) return;
    const heights = pulses.map((pulse) => place(pulse.height));
    const bar = (side) => pulses.map((pulse, n) => Math.abs(place(pulse.height + side * pulse.height_sd) - heights[n]));
    traces.push({
      type: "scatter", mode: "markers", name, x: pulses.map((pulse) => pulse.time), y: heights,
      marker: { size: 7, color: pulses[0].colour, line: { width: 1, color: colour("--ground") } },
      error_x: { array: pulses.map((pulse) => pulse.time_sd), color: pulses[0].colour, thickness: 1.5 },
      error_y: { array: bar(1), arrayminus: bar(-1), color: pulses[0].colour, thickness: 1.5 },
      text: pulses.map((pulse) => `${pulse.path}<br>${pulse.time} ± ${pulse.time_sd} ps<br>${pulse.height} ± ${pulse.height_sd} ${record.unit}${pulse.width ? `<br>${pulse.width} ps wide` : ""}`),
      hovertemplate: "%{text}<extra></extra>",
    });
  });
  const stem = (pulse) => ({ type: "line", xref: "x", yref: "y", x0: pulse.time, x1: pulse.time, y0: 0, y1: place(pulse.height), line: { color: pulse.colour, width: 1 } });
  const shapes = record.pulses.map(stem);
  const yaxis = { title: { text: record.unit === "V" ? (isLinear ? "signal (V)" : "signal") : "photons per bin" }, domain: [record.residual ? 0.34 : 0, 1], ...(isLinear ? {} : ticks(noise, record)) };
  const layout = { showlegend: true, legend: { orientation: "h", y: 1.02, yanchor: "bottom" }, margin: { l: 75, r: 12, t: 30, b: 50 }, hovermode: "closest", yaxis };
  const title = { text: "time of flight (ps)" };
  if (record.residual) {
    const most = Math.max(4.5, ...finite(record.residual).map(Math.abs)) * 1.05;
    traces.push({ type: "scatter", mode: "lines+markers", name: "residual", showlegend: false, x: record.time, y: record.residual, xaxis: "x", yaxis: "y2", line: { color: data, width: 0.8 }, marker: { size: 2.5, color: data }, hovertemplate: "%{x:,.0f} ps: %{y:.2f} standard errors<extra></extra>" });
    shapes.push({ type: "rect", xref: "paper", yref: "y2", x0: 0, x1: 1, y0: -2, y1: 2, fillcolor: ink, opacity: 0.18, line: { width: 0 }, layer: "below" });
    layout.yaxis2 = { title: { text: "residual (se)" }, domain: [0, 0.26], range: [-most, most] };
    layout.xaxis = { title, tickformat: ",~f", anchor: "y2" };
  } else layout.xaxis = { title, tickformat: ",~f" };
  return { data: traces, layout: { ...layout, shapes } };
};

// Ticks at zero and at powers of ten, of both signs, as far as the data go.
const ticks = (noise, { mean, unit }) => {
  const present = mean.filter((value) => value !== null);
  const [low, high] = [Math.min(...present), Math.max(...present)];
  const values = [0];
  const first = Math.ceil(Math.log10(noise * 2)), last = Math.floor(Math.log10(Math.max(Math.abs(low), Math.abs(high), noise * 20)));
  const [step, count] = [Math.max(1, Math.ceil((last - first + 1) / 7)), last - first];
  for (let n = count % step; n <= count; n += step) for (const sign of [1, -1]) {
    const value = sign * 10 ** (first + n);
    if (value < high * 3 && value > low * 3 && (sign > 0 || low < -2 * noise)) values.push(value);
  }
  values.sort((a, b) => a - b);
  return { tickmode: "array", tickvals: values.map((value) => Math.asinh(value / noise)), ticktext: values.map((value) => inWords(value, unit)) };
};

const inWords = (value, unit) => {
  if (value === 0) return "0";
  if (unit !== "V") return value.toLocaleString("en");
  const size = Math.abs(value), steps = [[1, ""], [1e-3, "m"], [1e-6, "µ"], [1e-9, "n"]];
  const [step, prefix] = steps.find(([step]) => size >= step * 0.999) ?? [1e-12, "p"];
  return `${+(value / step).toPrecision(2)} ${prefix}V`;
};

// The text alternative: pulses as a table.
const pulseTable = (record) => {
  const table = document.createElement("table");
  table.className = "numbers";
  const row = (cells, tag, into) => {
    const tr = into.insertRow();
    for (const cell of cells) {
      const element = document.createElement(tag);
      element.textContent = cell;
      tr.append(element);
    }
  };
  row(["time (ps)", "sd (ps)", `height (${record.unit})`, "sd", "width (ps)", "path"], "th", table.createTHead());
  const body = table.createTBody();
  for (const pulse of record.pulses) row([pulse.time, pulse.time_sd, pulse.height, pulse.height_sd, pulse.width, pulse.path], "td", body);
  return table;
};
