// Draws each plot when it comes into view, in the colours of the page; leads from a patch to its onsets, and from an onset to its profile.
(() => {
  const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  // Data name the colours of the light page.
  const themes = { "#256fae": "--visible", "#8453c8": "--mirror" };
  const parsed = (id) => JSON.parse(document.getElementById(id).textContent.replace(/#256fae|#8453c8/g, (given) => colour(themes[given])));
  const config = { responsive: true, displaylogo: false, modeBarButtonsToRemove: ["lasso2d", "select2d"] };
  const drawn = new Map(); // plot element -> what makes its figure

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

  const show = (plot, figure, again = () => figure) => {
    drawn.set(plot, again);
    // Buttons over a small plot would cover its legend.
    return Plotly.react(plot, figure.data, themed(figure.layout), { ...config, displayModeBar: plot.clientWidth > 640 ? "hover" : false });
  };

  // The viewer of profiles.
  const viewer = document.getElementById("profile");
  const choice = document.getElementById("profile-choice");
  let profiles = null, isLinear = false;
  const choose = (id) => {
    profiles ??= parsed(viewer.dataset.viewer);
    if (!(id in profiles)) return false;
    choice.value = id;
    const record = profiles[id];
    document.getElementById("profile-note").textContent = `${record.name}: ${record.note}`;
    viewer.setAttribute("aria-label", `Profile ${record.name} with its fitted curve and residuals`);
    document.querySelector("#profile-pulses .scroll").replaceChildren(pulseTable(record));
    show(viewer, profileFigure(record, isLinear, colour), () => profileFigure(record, isLinear, colour));
    return true;
  };
  if (viewer) {
    const beside = (by) => choose(choice.options[(choice.selectedIndex + by + choice.options.length) % choice.options.length].value);
    choice.addEventListener("change", () => choose(choice.value));
    document.getElementById("profile-before").addEventListener("click", () => beside(-1));
    document.getElementById("profile-after").addEventListener("click", () => beside(1));
    const toggle = document.getElementById("profile-scale");
    toggle.addEventListener("click", () => {
      isLinear = !isLinear;
      toggle.setAttribute("aria-pressed", isLinear);
      choose(choice.value);
    });
  }

  const draw = async (plot) => {
    if (drawn.has(plot)) return;
    if (plot === viewer) { choose(choice.value); return; }
    const made = () => {
      const figure = parsed(plot.id + "-data");
      // A narrow figure shows as much of the scene from farther away, and its bars of colours lie above it.
      const eye = figure.layout.scene?.camera?.eye;
      if (eye && plot.clientWidth < 600) {
        for (const axis of ["x", "y", "z"]) eye[axis] *= 1.5;
        for (const { marker } of figure.data) if (marker?.colorbar) Object.assign(marker.colorbar, { orientation: "h", x: 0.5, xanchor: "center", y: 1.02, yanchor: "bottom" });
      }
      return figure;
    };
    await show(plot, made(), made);
    if (plot.id !== "scene") return;
    plot.on("plotly_click", ({ points }) => {
      const id = points[0].id ?? points[0].data.ids?.[points[0].pointNumber];
      if (id !== undefined) location.hash = "patch-" + id;
    });
    keepLabelsApart(plot);
  };

  // The scene is turned by buttons too: about the vertical, up and down, nearer and farther.
  const scene = document.getElementById("scene");
  const turn = (how) => {
    const { x, y, z } = scene.layout?.scene?.camera?.eye ?? scene._fullLayout.scene.camera.eye;
    const far = Math.hypot(x, y, z) * ({ nearer: 0.8, farther: 1.25 }[how] ?? 1);
    const around = Math.atan2(y, x) + ({ left: -0.3, right: 0.3 }[how] ?? 0);
    const height = Math.atan2(z, Math.hypot(x, y)) + ({ up: 0.2, down: -0.2 }[how] ?? 0);
    const over = Math.min(1.5, Math.max(-1.5, height));
    const eye = { x: far * Math.cos(over) * Math.cos(around), y: far * Math.cos(over) * Math.sin(around), z: far * Math.sin(over) };
    Plotly.relayout(scene, { "scene.camera.eye": eye });
  };
  document.querySelectorAll("[data-turn]").forEach((button) => button.addEventListener("click", () => { if (drawn.has(scene)) turn(button.dataset.turn); }));

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
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => drawn.forEach((again, plot) => show(plot, again(), again)));
  follow();
})();
