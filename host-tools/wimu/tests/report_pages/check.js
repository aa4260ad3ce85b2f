// Uses every chart of the report that it is appended to, and posts what it saw to the page around it.
"use strict";
{
  const fire = (plot, type, x, y, more) => {
    const box = plot.canvas.getBoundingClientRect();
    const options = { clientX: box.left + x, clientY: box.top + y, pointerId: 1, pointerType: "mouse", button: 0, bubbles: true, cancelable: true, ...more };
    plot.canvas.dispatchEvent(type === "wheel" ? new WheelEvent(type, options) : type === "dblclick" ? new MouseEvent(type, options) : new PointerEvent(type, options));
  };
  // Number of pixels that are not transparent.
  const ink = (canvas) => {
    const pixels = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
    let count = 0;
    for (let k = 3; k < pixels.length; k += 4) if (pixels[k] > 0) count++;
    return count;
  };
  const width = (plot) => (plot.chart.space ? 1 / plot.view.zoom : plot.shown.x[1] - plot.shown.x[0]);
  const charts = [...document.querySelectorAll("figure")].map((figure) => {
    const { plot } = figure, { canvas, chart } = plot, home = JSON.stringify(plot.home);
    const [w, h] = [canvas.clientWidth, canvas.clientHeight], found = { title: chart.title, space: chart.space, ink: ink(canvas), width: w, height: h };
    const isHome = () => JSON.stringify(plot.view) === home && plot.button.style.display === "none";
    found.starts = isHome();
    // The middle of the first series that has values.
    const one = plot.series.find((one) => !one.guide && one.x.some(isFinite)), index = one.x.findIndex((v, k) => isFinite(v) && isFinite(one.y[k]) && k >= one.x.length / 2);
    const [x, y] = chart.space ? plot.project(one.x[index], one.y[index], one.z[index]) : [plot.px(one.x[index]), plot.py(one.y[index])];
    fire(plot, "pointermove", x, y);
    found.tip = plot.tip.style.display === "block" ? plot.tip.innerText : "";
    const tip = plot.tip.getBoundingClientRect();
    found.tipInside = tip.left >= 0 && tip.right <= innerWidth + 1;
    fire(plot, "pointerleave", x, y);
    found.tipGone = plot.tip.style.display === "none";
    const before = width(plot), turn = String(plot.view.turn);
    fire(plot, "pointerdown", w * 0.4, h * 0.4);
    fire(plot, "pointermove", w * 0.7, h * 0.6);
    fire(plot, "pointerup", w * 0.7, h * 0.6);
    found.dragged = chart.space ? String(plot.view.turn) !== turn : width(plot) / before;
    fire(plot, "dblclick", w / 2, h / 2);
    found.reset = isHome();
    canvas.focus({ preventScroll: true });
    fire(plot, "wheel", w / 2, h / 2, { deltaY: -100 });
    found.wheel = width(plot) / before;
    plot.button.click();
    found.button = isHome();
    const touch = (id) => ({ pointerId: id, pointerType: "touch" });
    fire(plot, "pointerdown", w * 0.4, h / 2, touch(5));
    fire(plot, "pointerdown", w * 0.6, h / 2, touch(6));
    fire(plot, "pointermove", w * 0.2, h / 2, touch(5));
    fire(plot, "pointermove", w * 0.8, h / 2, touch(6));
    fire(plot, "pointerup", w * 0.2, h / 2, touch(5));
    fire(plot, "pointerup", w * 0.8, h / 2, touch(6));
    found.pinch = width(plot) / before;
    plot.reset();
    const { shown, area } = plot;
    if (!chart.space) {
      found.perPixel = [(shown.x[1] - shown.x[0]) / area.w, (shown.y[1] - shown.y[0]) / area.h];
      found.ticks = ["x", "y"].map((axis) => plot.ticks(axis).map((tick) => tick.text).filter((text) => text));
    }
    return found;
  });
  parent.postMessage({
    innerWidth, charts, faults: window.faults, dark: getComputedStyle(document.body).backgroundColor,
    overflow: document.documentElement.scrollWidth - innerWidth, images: document.images.length,
    order: [".result", ".key", "figure", "details"].map((name) => document.querySelector(name)?.getBoundingClientRect().top ?? null),
    folded: [...document.querySelectorAll("details")].at(-1)?.open === false,
  }, "*");
}
