// A cloud that can be turned, drawn by WebGL 2 as the viewer draws it: points as large as their surface needs, with
// outlines where there is a step in depth. One finger or button turns, two fingers or the right button move.
"use strict";

const SLOPE = Math.tan(0.4); // of the upper edge of the picture
const OUTLINE = 1.4; // pixels of the page, as the viewer has it
const REACH = 3; // a point can be hit from so many pixels away
const PLACES = `#version 300 es
  precision highp float;
  layout(location = 0) in vec3 place;
  layout(location = 1) in float radius; // as a share of the largest
  layout(location = 2) in vec3 color;
  uniform vec3 eye;
  uniform mat3 axes; // columns: to the right, up, forward
  uniform vec2 focal; // of half the picture
  uniform float largest, height, near;
  out vec3 shown;
  flat out uint number;
  void main() {
    vec3 seen = (place - eye) * axes;
    gl_Position = vec4(focal * seen.xy, seen.z - 2.0 * near, seen.z);
    gl_PointSize = clamp(radius * largest * focal.y * height / seen.z, 1.5, 256.0);
    shown = color;
    number = uint(gl_VertexID) + 1u;
  }`;
const DISCS = `#version 300 es
  precision highp float;
  in vec3 shown;
  flat in uint number;
  layout(location = 0) out vec4 color;
  layout(location = 1) out uint hit;
  void main() {
    if (length(gl_PointCoord - 0.5) > 0.5) discard;
    color = vec4(shown, 1.0);
    hit = number;
  }`;
const PICTURE = `#version 300 es
  void main() { gl_Position = vec4(ivec2(gl_VertexID & 1, gl_VertexID >> 1) * 4 - 1, 0.5, 1.0); }`;

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const sum = (...terms) => [0, 1, 2].map((k) => terms.reduce((total, [factor, axis]) => total + factor * axis[k], 0));

class Cloud {
  /** points: Int16Array, x, y, z of each; radii: Uint16Array, and the `largest` of them; eyeDome: a fragment shader. */
  constructor(canvas, points, radii, largest, eyeDome) {
    Object.assign(this, { canvas, points, radii, largest, eyeDome, count: radii.length, colors: new Uint8Array(points.length) });
    this.onChosen = this.onHovered = () => {}; // a point's number, null beside the cloud; and the event
    this.fingers = new Map(); // where they are, or the mouse with a button
    canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
    canvas.addEventListener("webglcontextrestored", () => this.start());
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    canvas.addEventListener("pointerdown", (event) => this.press(event));
    canvas.addEventListener("pointermove", (event) => this.move(event));
    canvas.addEventListener("pointerleave", (event) => this.onHovered(null, event));
    for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, (event) => this.release(event));
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      const factor = Math.exp((event.deltaMode ? 0.03 : 0.001) * event.deltaY); // Firefox counts lines
      const point = factor < 1 ? this.at(event) : null; // what the mouse is at stays there
      if (point !== null) {
        const place = [...this.points.subarray(3 * point, 3 * point + 3)].map((value) => value / 32767);
        this.center = sum([factor, this.center], [1 - factor, place]);
      }
      this.zoom(factor);
    }, { passive: false });
    this.start();
  }

  /** Puts the cloud on the graphics processor; `gl` is null if the browser has no WebGL 2. */
  start() {
    const gl = (this.gl = this.canvas.getContext("webgl2", { alpha: false, antialias: false }));
    if (!gl) return;
    this.drawing = programOf(gl, PLACES, DISCS, ["eye", "axes", "focal", "largest", "height", "near"]);
    this.shading = programOf(gl, PICTURE, this.eyeDome, ["reversed", "radius"]);
    this.array = gl.createVertexArray();
    gl.bindVertexArray(this.array);
    const fill = (index, size, kind, values) => {
      const buffer = gl.createBuffer();
      gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
      gl.bufferData(gl.ARRAY_BUFFER, values, gl.DYNAMIC_DRAW);
      gl.enableVertexAttribArray(index);
      gl.vertexAttribPointer(index, size, kind, true, 0, 0);
      return buffer;
    };
    fill(0, 3, gl.SHORT, this.points);
    fill(1, 1, gl.UNSIGNED_SHORT, this.radii);
    this.painted = fill(2, 3, gl.UNSIGNED_BYTE, this.colors);
    this.target = gl.createFramebuffer();
    this.layers = [];
    this.draw();
  }

  /** Gives each point its colour, RGB. */
  paint(colors) {
    this.colors = colors;
    if (!this.gl) return;
    this.gl.bindBuffer(this.gl.ARRAY_BUFFER, this.painted);
    this.gl.bufferData(this.gl.ARRAY_BUFFER, colors, this.gl.DYNAMIC_DRAW);
    this.draw();
  }

  /** Takes what the other elements of the page leave; all but outliers are inside until somebody turns the cloud. */
  fit(views) {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    [this.canvas.width, this.canvas.height] = [width, height].map((side) => Math.max(1, Math.round(side * devicePixelRatio)));
    const [across, , ahead] = views[width < 0.8 * height ? 1 : 0]; // to the right, down, forward
    if (this.isTurned) return this.render(); // at once: it is black until the next picture
    [this.turn, this.tilt] = [Math.atan2(across[1], across[0]), Math.asin(-ahead[2])];
    const axes = this.axes();
    const along = axes.map((axis) => Float64Array.from(this.radii, (_, i) => dot(axis, this.points.subarray(3 * i)) / 32767));
    const radius = (i) => (this.radii[i] / 65535) * this.largest;
    const edge = (values) => { // as `_edge` of upright.py has it
      values.sort();
      const [least, low, middle] = [0.0005, 0.05, 0.5].map((share) => values[Math.floor(share * this.count)]);
      return Math.max(least, middle - 2 * (middle - low));
    };
    const sides = [(SLOPE * width) / height, SLOPE].map((slope, k) => { // the edges of the picture pass by
      const ends = [1, -1].map((side) => side * edge(along[k].map((value, i) => side * value + slope * along[2][i] - radius(i))));
      return { middle: (ends[0] + ends[1]) / 2, away: (ends[1] - ends[0]) / 2 / slope };
    });
    this.center = sum([sides[0].middle, axes[0]], [sides[1].middle, axes[1]]);
    this.away = 1.08 * Math.max(sides[0].away, sides[1].away, 1e-6);
    this.render();
  }

  axes() {
    const [turned, aside] = [Math.cos(this.turn), Math.sin(this.turn)];
    const [level, steep] = [Math.cos(this.tilt), Math.sin(this.tilt)];
    return [[turned, aside, 0], [-aside * steep, turned * steep, level], [-aside * level, turned * level, -steep]];
  }

  press(event) {
    this.canvas.setPointerCapture(event.pointerId);
    this.path = this.fingers.size ? Infinity : 0; // pixels; a press that moves chooses nothing
    this.slack = event.pointerType === "mouse" ? 4 : 10; // no finger is quite still
    this.fingers.set(event.pointerId, [event.offsetX, event.offsetY]);
  }

  move(event) {
    const [before, here] = [this.fingers.get(event.pointerId), [event.offsetX, event.offsetY]];
    if (!before) return this.onHovered(this.at(event), event);
    const [x, y] = [here[0] - before[0], here[1] - before[1]];
    this.fingers.set(event.pointerId, here);
    this.path += Math.hypot(x, y);
    if (this.path <= this.slack) return;
    this.onHovered(null, event);
    const others = [...this.fingers].filter(([id]) => id !== event.pointerId);
    const [right, up] = this.axes();
    const step = (2 * SLOPE * this.away) / this.canvas.clientHeight / (others.length + 1);
    if (others.length || event.buttons & 2) this.center = sum([1, this.center], [-x * step, right], [y * step, up]);
    else [this.turn, this.tilt] = [this.turn - 0.008 * x, Math.min(Math.max(this.tilt + 0.008 * y, -1.57), 1.57)];
    const [was, is] = [before, here].map((one) => (others.length ? Math.hypot(one[0] - others[0][1][0], one[1] - others[0][1][1]) : 1));
    this.zoom(Math.max(was, 1) / Math.max(is, 1));
  }

  release(event) {
    this.fingers.delete(event.pointerId);
    if (this.path <= this.slack && event.type === "pointerup" && event.button === 0) this.onChosen(this.at(event), event);
  }

  zoom(factor) {
    this.isTurned = true;
    this.away = Math.min(Math.max(this.away * factor, 1e-4), 50);
    this.draw();
  }

  /** The number of the point that an event is at, or nearest to; null: none. */
  at(event) {
    const { gl, canvas } = this;
    if (!gl) return null;
    if (this.waits) this.render(); // it was turned after it was drawn
    const [x, y] = [event.offsetX * devicePixelRatio, canvas.height - 1 - event.offsetY * devicePixelRatio].map(Math.round);
    const side = 2 * REACH + 1;
    const hits = new Uint32Array(side * side);
    gl.bindFramebuffer(gl.READ_FRAMEBUFFER, this.target);
    gl.readBuffer(gl.COLOR_ATTACHMENT1);
    gl.readPixels(x - REACH, y - REACH, side, side, gl.RED_INTEGER, gl.UNSIGNED_INT, hits);
    gl.readBuffer(gl.COLOR_ATTACHMENT0);
    gl.bindFramebuffer(gl.READ_FRAMEBUFFER, null);
    const far = (index) => Math.hypot((index % side) - REACH, Math.floor(index / side) - REACH);
    const nearest = [...hits.keys()].filter((index) => hits[index]).sort((a, b) => far(a) - far(b));
    return nearest.length ? hits[nearest[0]] - 1 : null;
  }

  draw() {
    this.waits ??= requestAnimationFrame(() => this.render());
  }

  render() {
    const { gl, canvas, drawing, shading } = this;
    cancelAnimationFrame(this.waits);
    this.waits = null;
    if (!gl || gl.isContextLost() || !this.center) return;
    const { width, height } = canvas;
    this.resize(width, height);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.target);
    gl.drawBuffers([gl.COLOR_ATTACHMENT0, gl.COLOR_ATTACHMENT1]);
    gl.viewport(0, 0, width, height);
    const ground = getComputedStyle(document.body).backgroundColor.match(/\d+/g).map((value) => value / 255);
    gl.clearBufferfv(gl.COLOR, 0, [...ground.slice(0, 3), 1]);
    gl.clearBufferuiv(gl.COLOR, 1, [0, 0, 0, 0]);
    gl.clearBufferfv(gl.DEPTH, 0, [1]);
    gl.enable(gl.DEPTH_TEST);
    gl.bindVertexArray(this.array);
    gl.useProgram(drawing.program);
    const axes = this.axes();
    gl.uniform3fv(drawing.eye, sum([1, this.center], [-this.away, axes[2]]));
    gl.uniformMatrix3fv(drawing.axes, false, axes.flat());
    gl.uniform2f(drawing.focal, height / width / SLOPE, 1 / SLOPE);
    gl.uniform1f(drawing.largest, this.largest);
    gl.uniform1f(drawing.height, height);
    gl.uniform1f(drawing.near, 0.01 * this.away);
    gl.drawArrays(gl.POINTS, 0, this.count);
    gl.bindFramebuffer(gl.DRAW_FRAMEBUFFER, null);
    gl.blitFramebuffer(0, 0, width, height, 0, 0, width, height, gl.COLOR_BUFFER_BIT, gl.NEAREST);
    gl.bindFramebuffer(gl.READ_FRAMEBUFFER, null); // else Chrome draws nothing after the next change of size
    gl.disable(gl.DEPTH_TEST);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ZERO, gl.SRC_COLOR); // the picture times the shade
    gl.useProgram(shading.program);
    gl.uniform1f(shading.radius, OUTLINE * devicePixelRatio);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    gl.disable(gl.BLEND);
  }

  /** Makes the layers of a picture, if it has another size: its colours, the numbers of its points, its depths. */
  resize(width, height) {
    const { gl } = this;
    if (this.layers.length && this.width === width && this.height === height) return;
    this.layers.forEach((layer) => gl.deleteTexture(layer));
    Object.assign(this, { width, height });
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.target);
    const kinds = [[gl.RGBA8, gl.COLOR_ATTACHMENT0], [gl.R32UI, gl.COLOR_ATTACHMENT1], [gl.DEPTH_COMPONENT24, gl.DEPTH_ATTACHMENT]];
    this.layers = kinds.map(([kind, place]) => {
      const layer = gl.createTexture();
      gl.bindTexture(gl.TEXTURE_2D, layer);
      gl.texStorage2D(gl.TEXTURE_2D, 1, kind, width, height);
      for (const filter of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, filter, gl.NEAREST);
      gl.framebufferTexture2D(gl.FRAMEBUFFER, place, gl.TEXTURE_2D, layer, 0);
      return layer; // the last one, the depths, stays bound for the shade
    });
  }
}

function programOf(gl, vertex, fragment, uniforms) {
  const program = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  return { program, ...Object.fromEntries(uniforms.map((name) => [name, gl.getUniformLocation(program, name)])) };
}
