// Interactive charts, by uPlot, in place of the static figures of signals over time.
const stored = document.getElementById("chart-data");
const media = matchMedia("(prefers-color-scheme: dark)");
const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
const font = (size) => `${size}px system-ui, -apple-system, "Segoe UI", Roboto, sans-serif`;
const MISSING = -32768, LARGEST = 32767;  // of 16 bits, as `charts.py` writes them

function decode({ data, low, unit }) {
  const bytes = Uint8Array.from(atob(data), (letter) => letter.charCodeAt(0));
  const codes = new DataView(bytes.buffer), values = new Array(bytes.length / 2);
  for (let i = 0; i < values.length; i++) {
    const code = codes.getInt16(2 * i, true);
    values[i] = code === MISSING ? null : low + (code + LARGEST) * unit;
  }
  return values;
}

// Two points for each interval of `size` samples, or every sample.
function stamps({ start, step, count, size }) {
  const last = start + (count - 1) * step;
  if (size === 1) return Array.from({ length: count }, (_, i) => start + i * step);
  const place = (i) => ((i >> 1) + (i % 2 ? 0.75 : 0.25)) * size - 0.5;
  return Array.from({ length: 2 * Math.ceil(count / size) }, (_, i) => Math.min(start + place(i) * step, last));
}

function reading(value) {
  if (value == null) return "–";
  return value !== 0 && Math.abs(value) < 1e-3 ? value.toExponential(4) : value.toPrecision(5);
}

function tickLabels(_, splits, __, ___, step) {
  const largest = Math.max(...splits.map(Math.abs));
  if (largest >= 1e5 || largest < 1e-2) {
    const digits = Math.max(0, Math.floor(Math.log10(largest)) - Math.floor(Math.log10(step)));
    return splits.map((value) => (value === 0 ? "0" : value.toExponential(Math.min(digits, 8))));
  }
  let digits = 0;
  while (digits < 8 && Math.abs(step - step.toFixed(digits)) > 1e-3 * step) digits++;
  return splits.map((value) => value.toFixed(digits));
}

// All charts of one record show the same interval of time.
class TimeAxis {
  constructor(first, last, step) { Object.assign(this, { first, last, step, charts: [], range: [first, last], busy: false }); }
  show(from, to) {
    const width = Math.min(Math.max(to - from, 4 * this.step), this.last - this.first);
    const low = Math.min(Math.max(from + (to - from - width) / 2, this.first), this.last - width);
    this.range = [low, low + width];
    this.busy = true;
    for (const chart of this.charts) chart.setScale("x", { min: low, max: low + width });
    this.busy = false;
  }
  zoom(factor, centre = (this.range[0] + this.range[1]) / 2) {
    this.show(...this.range.map((end) => centre + (end - centre) * factor));
  }
  pan(share) {
    const way = share * (this.range[1] - this.range[0]);
    this.show(this.range[0] + way, this.range[1] + way);
  }
  reset() { this.show(this.first, this.last); }
}

// Shift and the mouse, or one finger: the time below it moves along. Two fingers, or the wheel with
// Ctrl: zoom.
function addGestures(area, axis) {
  const fingers = new Map();  // share of the width, and the time that stays below the finger
  const share = (event) => { const box = area.getBoundingClientRect(); return (event.clientX - box.left) / box.width; };
  const time = (place) => axis.range[0] + place * (axis.range[1] - axis.range[0]);
  const hold = () => { for (const finger of fingers.values()) finger.time = time(finger.place); };
  const release = (event) => { fingers.delete(event.pointerId); hold(); };
  area.addEventListener("pointerdown", (event) => {
    if (event.pointerType !== "touch" && !event.shiftKey) return;
    fingers.set(event.pointerId, { place: share(event) });
    area.setPointerCapture(event.pointerId);
    hold();
  });
  area.addEventListener("pointermove", (event) => {
    if (!fingers.has(event.pointerId)) return;
    fingers.get(event.pointerId).place = share(event);
    const [a, b] = [...fingers.values()];
    let width = axis.range[1] - axis.range[0];
    if (b) {
      width = (b.time - a.time) / (b.place - a.place);
      if (!(width > 0 && width < Infinity)) return;
    }
    axis.show(a.time - a.place * width, a.time + (1 - a.place) * width);
  });
  area.addEventListener("pointerup", release);
  area.addEventListener("pointercancel", release);
  area.addEventListener("wheel", (event) => {
    if (event.ctrlKey || event.metaKey) axis.zoom(Math.exp(Math.sign(event.deltaY) * 0.25), time(share(event)));
    else if (Math.abs(event.deltaX) > Math.abs(event.deltaY)) axis.pan(event.deltaX / area.clientWidth);
    else return;
    event.preventDefault();
  }, { passive: false });
}

function seriesOptions(signal) {
  return {
    label: signal.label,
    stroke: () => colour(signal.colour),
    width: signal.width * 1.2,
    value: (_, value) => reading(value),
    paths: signal.dots ? () => null : signal.held ? uPlot.paths.stepped({ align: 1 }) : undefined,
    points: signal.dots ? { show: true, size: 4, fill: () => colour(signal.colour) } : { show: false },
  };
}

function options(panel, axis, axes, key, width, isLast) {
  const swatch = (_, index) => `var(${panel.signals[index - 1].colour})`;
  const clipped = (_, low, high) => {
    if (low == null) return [0, 1];
    const margin = 0.05 * (high - low) || 0.05 * Math.abs(high) || 1;
    const [least, most] = panel.limits ?? [-Infinity, Infinity];
    return [Math.max(low - margin, least), Math.min(high + margin, most)];
  };
  const lines = { stroke: () => colour("--ink"), grid: { stroke: () => colour("--grid"), width: 1 }, ticks: { stroke: () => colour("--grid"), width: 1 }, font: font(12) };
  return {
    width,
    height: Math.round(88 * panel.height) + (isLast ? 38 : 12),
    scales: { x: { time: false, range: (_, low, high) => [low, high] }, y: { range: clipped } },
    series: [{ label: "time", value: (_, value) => (value == null ? "–" : `${value.toPrecision(6)} s`) }, ...panel.signals.map(seriesOptions)],
    axes: [
      { ...lines, values: isLast ? tickLabels : (_, splits) => splits.map(() => ""), size: isLast ? 36 : 8 },
      { ...lines, values: tickLabels, size: 64, space: 22 },
    ],
    padding: [8, 8, 0, 0],
    legend: { markers: { stroke: swatch, fill: swatch, width: 2 } },
    focus: { alpha: 1 },
    cursor: {
      y: false,
      drag: { x: true, y: false },
      points: { size: 7, stroke: swatch, fill: swatch },
      // The position is shared; zooming is linked by the axis.
      sync: { key, scales: ["x", null], filters: { pub: (kind) => kind === "mousemove" || kind === "mouseleave" } },
      bind: {
        mousedown: (_, __, handler) => (event) => (event.shiftKey ? null : handler(event)),
        dblclick: () => () => axis.reset(),
      },
    },
    hooks: {
      setScale: [(chart, name) => {
        if (name === "x" && !axis.busy) axis.show(chart.scales.x.min, chart.scales.x.max);
      }],
      setSeries: [(chart, index, { show }) => {
        if (show == null) return;
        for (const other of axes) {
          other.series.forEach((series, i) => {
            if (i && series.label === chart.series[index].label && series.show !== show) other.setSeries(i, { show });
          });
        }
        for (const button of chart.root.querySelectorAll(".u-series th[role]")) button.ariaPressed = String(!button.parentElement.classList.contains("u-off"));
      }],
    },
  };
}

// A legend entry is a button, for the keyboard too.
function addButtons(chart) {
  [...chart.root.querySelectorAll(".u-series th")].slice(1).forEach((entry) => {
    Object.assign(entry, { tabIndex: 0, role: "button", ariaPressed: "true", title: "Show or hide" });
    entry.addEventListener("keydown", (event) => {
      if (event.key !== "Enter" && event.key !== " ") return;
      event.preventDefault();
      entry.click();
    });
  });
}

function toolbar(axis) {
  const bar = document.createElement("div");
  bar.className = "tools";
  const actions = [
    ["+", "Zoom in", () => axis.zoom(0.5)], ["−", "Zoom out", () => axis.zoom(2)],
    ["←", "Earlier", () => axis.pan(-0.5)], ["→", "Later", () => axis.pan(0.5)], ["Reset", "Show all", () => axis.reset()],
  ];
  for (const [text, title, action] of actions) {
    const button = document.createElement("button");
    Object.assign(button, { type: "button", textContent: text, title, ariaLabel: title });
    button.addEventListener("click", action);
    bar.append(button);
  }
  return bar;
}

function hint() {
  const text = document.createElement("p");
  text.className = "small hint";
  text.textContent = matchMedia("(pointer: coarse)").matches
    ? "In the charts: one finger moves the section of time, two fingers zoom; a tap shows values, a tap on a name hides its line."
    : "In the charts: drag to zoom, Shift and drag to move, double-click for the whole record; a click on a name hides its line.";
  return text;
}

function build(name, content, signal, timeAxes) {
  const figure = document.getElementById(name), box = document.createElement("div");
  const key = content.record;
  const last = content.start + (content.count - 1) * content.step;
  const axis = (timeAxes[key] ??= new TimeAxis(content.start, last, content.step));
  const time = stamps(content), charts = [];
  box.className = "chart";
  figure.classList.add("live");
  figure.querySelector("figcaption").after(box);
  box.append(toolbar(axis));
  content.panels.forEach((panel, i) => {
    const label = document.createElement("p");
    label.textContent = panel.title ? `${panel.label} (${panel.title})` : panel.label;
    box.append(label);
    const isLast = i === content.panels.length - 1;
    const data = [time, ...panel.signals.map((line) => signal(line.signal))];
    const chart = new uPlot(options(panel, axis, charts, key, box.clientWidth, isLast), data, box);
    charts.push(chart);
    axis.charts.push(chart);
    addGestures(chart.over, axis);
    addButtons(chart);
    if (!isLast) chart.root.querySelector(".u-series").hidden = true;  // the time, once
  });
  const label = document.createElement("p");
  label.className = "time";
  label.textContent = content.label;
  box.append(label);
  new ResizeObserver(() => {
    for (const chart of charts) if (box.clientWidth && box.clientWidth !== chart.width) chart.setSize({ width: box.clientWidth, height: chart.height });
  }).observe(box);
  return charts;
}

if (stored) {
  const { signals, charts } = JSON.parse(stored.textContent), decoded = [], timeAxes = {};
  const signal = (index) => (decoded[index] ??= decode(signals[index]));
  const all = Object.entries(charts).flatMap(([name, content]) => build(name, content, signal, timeAxes));
  for (const axis of Object.values(timeAxes)) axis.reset();
  document.querySelector("#figures h2").after(hint());
  media.addEventListener("change", () => { for (const chart of all) chart.redraw(false, true); });
}
