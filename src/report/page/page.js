"use strict";
// Draws each plot when it comes into view, in the colours of the page; leads from a patch to its onsets, and from an onset to its profile.
(() => {
  const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const parsed = (id) => JSON.parse(document.getElementById(id).textContent);
  const config = { responsive: true, displaylogo: false, modeBarButtonsToRemove: ["lasso2d", "select2d"] };
  const drawn = new Map(); // plot element -> its figure as stored

  const themed = (layout) => {
    const ink = colour("--ink"), line = colour("--line");
    const axis = (given) => ({ gridcolor: line, zerolinecolor: line, linecolor: line, automargin: true, ...given });
    const theme = { ...layout, font: { color: ink, family: "system-ui, sans-serif", size: 13 }, paper_bgcolor: "rgba(0,0,0,0)", modebar: { bgcolor: "rgba(0,0,0,0)", color: colour("--pale"), activecolor: ink }, plot_bgcolor: layout.plot_bgcolor ? line : "rgba(0,0,0,0)" };
    for (const key of Object.keys(layout)) if (/^[xy]axis/.test(key)) theme[key] = axis(layout[key]);
    if (layout.scene) {
      theme.scene = { ...layout.scene };
      for (const key of ["xaxis", "yaxis", "zaxis"]) theme.scene[key] = { ...layout.scene[key], gridcolor: line, zerolinecolor: line, color: ink, showbackground: false };
    }
    if (layout.sliders) theme.sliders = layout.sliders.map((slider) => ({ ...slider, bgcolor: line, bordercolor: line, activebgcolor: colour("--accent"), font: { color: ink }, currentvalue: { ...slider.currentvalue, font: { color: ink } } }));
    return theme;
  };

  const show = (plot, figure) => {
    drawn.set(plot, figure);
    return Plotly.react(plot, figure.data, themed(figure.layout), config);
  };

  // The viewer of profiles.
  const viewer = document.getElementById("profile");
  const choice = document.getElementById("profile-choice");
  let profiles = null, scale = null;
  const choose = (id) => {
    profiles ??= parsed(viewer.dataset.viewer);
    if (!(id in profiles)) return false;
    choice.value = id;
    const { figure, note } = profiles[id];
    const layout = { ...figure.layout, yaxis: { ...figure.layout.yaxis, type: scale ?? figure.layout.yaxis.type } };
    document.getElementById("profile-note").textContent = note;
    show(viewer, { data: figure.data, layout });
    return true;
  };
  if (viewer) {
    const beside = (by) => choose(choice.options[(choice.selectedIndex + by + choice.options.length) % choice.options.length].value);
    choice.addEventListener("change", () => choose(choice.value));
    document.getElementById("profile-before").addEventListener("click", () => beside(-1));
    document.getElementById("profile-after").addEventListener("click", () => beside(1));
    document.getElementById("profile-scale").addEventListener("click", () => {
      scale = viewer.layout.yaxis.type === "log" ? "linear" : "log";
      choose(choice.value);
    });
  }

  const draw = async (plot) => {
    if (drawn.has(plot)) return;
    if (plot === viewer) { choose(choice.value); return; }
    await show(plot, parsed(plot.id + "-data"));
    if (plot.id === "scene") plot.on("plotly_click", ({ points }) => {
      const id = points[0].id ?? points[0].data.ids?.[points[0].pointNumber];
      if (id !== undefined) location.hash = "patch-" + id;
    });
  };

  const follow = () => {
    const id = decodeURIComponent(location.hash.slice(1));
    if (id.startsWith("profile-") && viewer && choose(id)) viewer.scrollIntoView({ block: "center" });
    const target = id && document.getElementById(id);
    if (target instanceof HTMLDetailsElement) { target.open = true; target.scrollIntoView(); }
  };

  const plots = document.querySelectorAll(".plot");
  const seen = new IntersectionObserver((entries) => {
    for (const { isIntersecting, target } of entries) if (isIntersecting) { seen.unobserve(target); draw(target); }
  }, { rootMargin: "600px" });
  plots.forEach((plot) => seen.observe(plot));
  addEventListener("hashchange", follow);
  // A sheet is narrower than the screen, and plots do not shrink with it by themselves.
  const sheet_px = 660;
  addEventListener("beforeprint", () => plots.forEach((plot) => { draw(plot); Plotly.relayout(plot, { width: sheet_px }); }));
  addEventListener("afterprint", () => plots.forEach((plot) => Plotly.relayout(plot, { width: null, autosize: true })));
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => drawn.forEach((figure, plot) => show(plot, figure)));
  follow();
})();
