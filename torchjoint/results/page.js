// The page of a result: it paints the cloud and its pictures at the chosen level, and lights up what is clicked.
"use strict";

const data = JSON.parse(document.getElementById("data").textContent);
const plot = document.querySelector(".js-plotly-plot");
const [mode, level, told, clear] = ["mode", "level", "told", "clear"].map((id) => document.getElementById(id));
const unpack = ([kind, text]) => new globalThis[kind](Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer);
const pieces = unpack(data.pieces); // of the points
const light = unpack(data.light); // of the points, 0 to 255
const palette = unpack(data.palette); // RGB of each hue
const own = Object.fromEntries(Object.entries(data.own).map(([name, colors]) => [name, unpack(colors)])); // RGB of points
const levels = data.levels.map((one) => ({ ids: unpack(one.ids), hues: unpack(one.hues), count: one.count, names: one.names }));
const pale = matchMedia("(prefers-color-scheme: dark)").matches ? 30 : 200; // what is not selected, nearly the background
let selected = null; // an id
let pictures = [];

const now = () => levels[level.value];
const called = (id) => `segment ${id}${now().names[id] ? ` ${now().names[id]}` : ""}`;

function paintCloud() {
  const { ids, hues } = now();
  const colors = own[mode.value];
  const paint = Array.from(pieces, (piece, point) => {
    const id = ids[piece];
    const [from, at] = colors ? [colors, 3 * point] : [palette, 3 * hues[piece]];
    const shade = mode.value === "colours" ? 1 : light[point] / 255;
    const rgb = [0, 1, 2].map((k) => from[at + k] * shade);
    const faded = selected === null || selected === id ? rgb : rgb.map((value) => 0.15 * value + pale);
    return `rgb(${faded.map(Math.round).join()})`;
  });
  const plain = (text) => text.replace(/&/g, "&amp;").replace(/</g, "&lt;"); // Plotly reads tags
  const text = Array.from(ids, (id) => plain(called(id)));
  Plotly.restyle(plot, { "marker.color": [paint], text: [Array.from(pieces, (piece) => text[piece])] });
}

function paintPicture({ canvas, photo, labels }) {
  const { width, height } = canvas;
  const context = canvas.getContext("2d");
  const image = new ImageData(new Uint8ClampedArray(photo), width, height);
  const { ids, hues } = now();
  const idOf = (pixel) => (labels[pixel] < 0 ? -1 : ids[labels[pixel]]);
  for (let pixel = 0; pixel < labels.length; pixel++) {
    const id = idOf(pixel);
    const shown = id >= 0 && (selected === null || id === selected);
    const painted = shown && (mode.value !== "colours" || selected !== null);
    const ends = [pixel % width < width - 1 ? idOf(pixel + 1) : id, pixel + width < labels.length ? idOf(pixel + width) : id];
    const border = ends.some((end) => end !== id && (selected === null || [id, end].includes(selected)));
    for (let k = 0; k < 3; k++) {
      const value = photo[4 * pixel + k];
      const faded = selected === null || shown ? value : 0.5 * value + 64;
      const color = painted ? 0.5 * (value + palette[3 * hues[labels[pixel]] + k]) : faded;
      image.data[4 * pixel + k] = border && (mode.value !== "colours" || selected !== null) ? 255 : color;
    }
  }
  context.putImageData(image, 0, 0);
}

function paint() {
  told.textContent = selected === null ? "Click a segment in the cloud or in a picture." : called(selected);
  clear.hidden = selected === null;
  document.getElementById("count").textContent = `${now().count} segments`;
  paintCloud();
  pictures.forEach(paintPicture);
}

function select(id) {
  selected = id === selected || id < 0 ? null : id; // a second click clears
  paint();
}

async function pixelsOf(image, canvas) {
  await image.decode();
  const context = canvas.getContext("2d", { willReadFrequently: true });
  context.drawImage(image, 0, 0);
  return context.getImageData(0, 0, canvas.width, canvas.height).data;
}

async function readPicture(canvas) {
  const [photo, coded] = canvas.querySelectorAll("img");
  [canvas.width, canvas.height] = [photo.width, photo.height];
  const code = await pixelsOf(coded, canvas); // the piece + 1 in red, green and blue, lowest byte first
  const labels = Int32Array.from({ length: code.length / 4 }, (_, pixel) => {
    const [red, green, blue] = code.subarray(4 * pixel, 4 * pixel + 3);
    return red + 256 * green + 65536 * blue - 1;
  });
  canvas.addEventListener("click", (event) => {
    const pixel = Math.floor(event.offsetY) * canvas.width + Math.floor(event.offsetX);
    select(labels[pixel] < 0 ? -1 : now().ids[labels[pixel]]);
  });
  return { canvas, labels, photo: await pixelsOf(photo, canvas) };
}

mode.addEventListener("change", paint);
level.addEventListener("input", () => {
  selected = null;
  paint();
});
clear.addEventListener("click", () => select(-1));
// Plotly's own click also comes when the cloud is turned: only a press that does not move counts.
let under = null; // the point under the mouse
let pressed = null;
let tapped = -Infinity; // when a finger did not move; only Plotly's own click tells its point, after that
let last; // a timer: of several such clicks the first may tell the point of an earlier one
const choose = (point) => select(now().ids[pieces[point]]);
plot.on("plotly_hover", (event) => (under = event.points[0].pointNumber));
plot.on("plotly_unhover", () => (under = null));
plot.on("plotly_click", (event) => {
  if (performance.now() - tapped > 3000) return;
  clearTimeout(last);
  last = setTimeout((point) => { tapped = -Infinity; choose(point); }, 200, event.points[0].pointNumber);
});
plot.addEventListener("pointerdown", (event) => (pressed = [event.clientX, event.clientY]), true);
window.addEventListener("pointerup", (event) => {
  const moved = pressed === null || Math.hypot(event.clientX - pressed[0], event.clientY - pressed[1]) > 4;
  pressed = null;
  if (!moved && event.pointerType === "touch") tapped = performance.now();
  else if (!moved && under !== null) choose(under);
}, true);
// The cloud takes what the other elements leave, and is as large as it allows; all but outliers are inside.
function fit() {
  const { aspectratio, xaxis, yaxis, zaxis, _scene: drawn } = plot._fullLayout.scene;
  const { clientWidth: width, clientHeight: height } = plot;
  const axes = plot.layout.meta[width < 0.8 * height ? 1 : 0]; // to the right, down, forward
  const slope = Math.tan((drawn.glplot.fovy ?? Math.PI / 4) / 2);
  const sides = [[xaxis, "x"], [yaxis, "y"], [zaxis, "z"]].map(([{ range: [from, to] }, name]) => {
    const scale = aspectratio[name] / (to - from);
    return Float64Array.from(plot._fullData[0][name], (value) => (value - (from + to) / 2) * scale);
  });
  const along = axes.map((axis) => sides[0].map((_, i) => axis[0] * sides[0][i] + axis[1] * sides[1][i] + axis[2] * sides[2][i]));
  const [across, down] = [(slope * width) / height, slope].map((tangent, k) => { // the edges of the picture pass by
    const [low, high] = [1, -1].map((side) => along[k].map((value, i) => value + side * tangent * along[2][i]).sort());
    const left = Math.floor(0.0005 * low.length);
    const ends = [low[left], high[high.length - 1 - left]];
    return { middle: (ends[0] + ends[1]) / 2, away: (ends[1] - ends[0]) / 2 / tangent };
  });
  const away = 1.08 * Math.max(across.away, down.away, 1e-6);
  const point = (k, back) => across.middle * axes[0][k] + down.middle * axes[1][k] - back * axes[2][k];
  const [eye, center] = [away, 0].map((back) => ({ x: point(0, back), y: point(1, back), z: point(2, back) }));
  return Plotly.relayout(plot, { "scene.camera.eye": eye, "scene.camera.center": center });
}
Plotly.Plots.resize(plot).then(() => {
  const side = Math.min(plot.clientHeight, plot.clientWidth);
  Plotly.restyle(plot, { "marker.size": Math.max(1.8, (1.2 * side) / Math.sqrt(pieces.length)) }); // no gaps
  return fit();
});
paint();
Promise.all(Array.from(document.querySelectorAll("canvas.picture"), readPicture)).then((read) => {
  pictures = read;
  pictures.forEach(paintPicture);
});
