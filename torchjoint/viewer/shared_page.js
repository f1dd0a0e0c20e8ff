// The page of a result: it paints the cloud and its pictures at the chosen level, and lights up what is clicked.
"use strict";

const data = JSON.parse(document.getElementById("data").textContent);
const [mode, reset, level, told, clear, tip] = ["mode", "reset", "level", "told", "clear", "tip"].map((id) => document.getElementById(id));
const unpack = ([kind, text]) => new globalThis[kind](Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer);
const pieces = unpack(data.pieces); // of the points
const light = unpack(data.light); // of the points, 0 to 255
const palette = unpack(data.palette); // RGB of each hue
const own = Object.fromEntries(Object.entries(data.own).map(([name, colors]) => [name, unpack(colors)])); // RGB of points
const levels = data.levels.map((one) => ({ ids: unpack(one.ids), hues: unpack(one.hues), count: one.count, names: one.names }));
const pale = matchMedia("(prefers-color-scheme: dark)").matches ? 30 : 200; // what is not selected, nearly the background
const cloud = new Cloud(document.getElementById("cloud"), unpack(data.points), unpack(data.radii), data.largest, data.eyeDome);
let selected = null; // an id
let hovered = null;
let pictures = [];

const now = () => levels[level.value];
const called = (id) => `segment ${id}${now().names[id] ? ` ${now().names[id]}` : ""}`;

function paintCloud() {
  const { ids, hues } = now();
  const colors = own[mode.value];
  const painted = new Uint8Array(3 * pieces.length);
  pieces.forEach((piece, point) => {
    const id = ids[piece];
    const [from, at] = colors ? [colors, 3 * point] : [palette, 3 * hues[piece]];
    const shade = mode.value === "colours" ? 1 : light[point] / 255;
    for (let k = 0; k < 3; k++) {
      const value = shade * from[at + k];
      const faded = (id === hovered ? 0.4 : 0.15) * value + (id === hovered ? 0.7 : 1) * pale;
      const lit = id === hovered && selected === null ? 0.5 * value + 128 : value;
      painted[3 * point + k] = selected === null || selected === id ? lit : faded;
    }
  });
  cloud.paint(painted);
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
  const places = document.querySelector(".picture") ? "the cloud or in a picture" : "the cloud";
  const nothing = cloud.gl ? `Click a segment in ${places}.` : "The cloud needs a browser with WebGL 2.";
  told.textContent = selected === null ? nothing : called(selected);
  clear.hidden = selected === null;
  document.getElementById("count").textContent = `${now().count} segment${now().count === 1 ? "" : "s"}`;
  paintCloud();
  pictures.forEach(paintPicture);
}

function select(id) {
  selected = id === selected || id < 0 ? null : id; // a second click clears
  paint();
}

function pixelsOf(image, canvas) {
  const context = canvas.getContext("2d", { willReadFrequently: true });
  context.drawImage(image, 0, 0);
  return context.getImageData(0, 0, canvas.width, canvas.height).data;
}

async function readPicture(canvas) {
  const [photo, coded] = canvas.querySelectorAll("img");
  await Promise.all([photo.decode(), coded.decode()]); // before that, it has no size in Firefox
  [canvas.width, canvas.height] = [photo.naturalWidth, photo.naturalHeight];
  const code = pixelsOf(coded, canvas); // the piece + 1 in red, green and blue, lowest byte first
  const labels = Int32Array.from({ length: code.length / 4 }, (_, pixel) => {
    const [red, green, blue] = code.subarray(4 * pixel, 4 * pixel + 3);
    return red + 256 * green + 65536 * blue - 1;
  });
  canvas.addEventListener("click", (event) => {
    const pixel = Math.floor(event.offsetY) * canvas.width + Math.floor(event.offsetX);
    select(labels[pixel] < 0 ? -1 : now().ids[labels[pixel]]);
  });
  return { canvas, labels, photo: pixelsOf(photo, canvas) };
}

mode.addEventListener("change", paint);
level.addEventListener("input", () => {
  [selected, hovered, tip.hidden] = [null, null, true]; // ids are those of another level
  paint();
});
clear.addEventListener("click", () => select(-1));
reset.addEventListener("click", () => {
  cloud.isTurned = false;
  cloud.fit(data.views);
});
const idAt = (point) => (point === null ? null : now().ids[pieces[point]]);
cloud.onChosen = (point) => select(idAt(point) ?? -1);
cloud.onHovered = (point, event) => {
  const id = event.pointerType === "mouse" ? idAt(point) : null;
  tip.hidden = id === null;
  tip.textContent = id === null ? "" : called(id);
  const [x, y] = [event.clientX + 12, event.clientY + 12];
  tip.style.translate = `${Math.max(Math.min(x, innerWidth - tip.offsetWidth), 0)}px ${Math.min(y, innerHeight - tip.offsetHeight)}px`;
  if (id !== hovered) {
    hovered = id;
    paintCloud();
  }
};
new ResizeObserver(() => cloud.fit(data.views)).observe(cloud.canvas);
paint();
Promise.all(Array.from(document.querySelectorAll("canvas.picture"), readPicture)).then((read) => {
  pictures = read;
  pictures.forEach(paintPicture);
});
