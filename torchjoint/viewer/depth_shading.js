// Viser has no passes after its own, as eye-dome lighting is (eye_dome.glsl). Its picture stays in the canvas, so the
// depths of a picture are read after it was drawn, and the shade is multiplied in.
"use strict";
(() => {
  if (window.torchjointDepth) return;
  window.torchjointDepth = true;

  const RADIUS = 1.4; // pixels of the page, as CloudCompare has it
  const VERTEX = `#version 300 es
    void main() { gl_Position = vec4(ivec2(gl_VertexID & 1, gl_VertexID >> 1) * 4 - 1, 0.5, 1.0); }`;
  const FRAGMENT = document.getElementById("tj-page").dataset.eyeDome;

  const programOf = (gl) => {
    const program = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    return gl.getProgramParameter(program, gl.LINK_STATUS) ? program : null;
  };

  // The depths of the canvas are copied to a texture, which must have their format; WebGL does not tell which it is.
  const copyOf = (gl, width, height) => {
    const kinds = [
      [gl.DEPTH24_STENCIL8, gl.DEPTH_STENCIL_ATTACHMENT], [gl.DEPTH_COMPONENT24, gl.DEPTH_ATTACHMENT],
      [gl.DEPTH_COMPONENT32F, gl.DEPTH_ATTACHMENT], [gl.DEPTH32F_STENCIL8, gl.DEPTH_STENCIL_ATTACHMENT],
    ];
    for (const [format, attachment] of kinds) {
      const [texture, frame] = [gl.createTexture(), gl.createFramebuffer()];
      gl.bindTexture(gl.TEXTURE_2D, texture);
      gl.texStorage2D(gl.TEXTURE_2D, 1, format, width, height);
      for (const filter of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) {
        gl.texParameteri(gl.TEXTURE_2D, filter, gl.NEAREST);
      }
      gl.bindFramebuffer(gl.FRAMEBUFFER, frame);
      gl.framebufferTexture2D(gl.FRAMEBUFFER, attachment, gl.TEXTURE_2D, texture, 0);
      while (gl.getError() !== gl.NO_ERROR);
      const copy = { texture, frame, width, height };
      fill(gl, copy);
      if (gl.getError() === gl.NO_ERROR) return copy;
      remove(gl, copy);
    }
    return null;
  };
  const fill = (gl, { frame, width, height }) => {
    gl.bindFramebuffer(gl.READ_FRAMEBUFFER, null);
    gl.bindFramebuffer(gl.DRAW_FRAMEBUFFER, frame);
    gl.blitFramebuffer(0, 0, width, height, 0, 0, width, height, gl.DEPTH_BUFFER_BIT, gl.NEAREST);
  };
  const remove = (gl, { texture, frame }) => {
    gl.deleteFramebuffer(frame);
    gl.deleteTexture(texture);
  };

  // What is set here, three.js believes to be as it left it.
  const keepingState = (gl, action) => {
    const switches = [gl.BLEND, gl.DEPTH_TEST, gl.CULL_FACE, gl.SCISSOR_TEST, gl.STENCIL_TEST, gl.SAMPLE_ALPHA_TO_COVERAGE];
    const were = switches.map((one) => gl.isEnabled(one));
    const get = (...names) => names.map((name) => gl.getParameter(name));
    const [unit] = get(gl.ACTIVE_TEXTURE);
    gl.activeTexture(gl.TEXTURE0);
    const [program, array, texture, sampler, drawn, read, viewport, mask] = get(
      gl.CURRENT_PROGRAM, gl.VERTEX_ARRAY_BINDING, gl.TEXTURE_BINDING_2D, gl.SAMPLER_BINDING, gl.DRAW_FRAMEBUFFER_BINDING,
      gl.READ_FRAMEBUFFER_BINDING, gl.VIEWPORT, gl.COLOR_WRITEMASK,
    );
    const factors = get(gl.BLEND_SRC_RGB, gl.BLEND_DST_RGB, gl.BLEND_SRC_ALPHA, gl.BLEND_DST_ALPHA);
    const equations = get(gl.BLEND_EQUATION_RGB, gl.BLEND_EQUATION_ALPHA);
    for (const one of switches) gl.disable(one);
    try {
      action();
    } finally {
      switches.forEach((one, index) => (were[index] ? gl.enable(one) : gl.disable(one)));
      gl.blendFuncSeparate(...factors);
      gl.blendEquationSeparate(...equations);
      gl.colorMask(...mask);
      gl.viewport(...viewport);
      gl.useProgram(program);
      gl.bindVertexArray(array);
      gl.bindTexture(gl.TEXTURE_2D, texture);
      gl.bindSampler(0, sampler);
      gl.activeTexture(unit);
      gl.bindFramebuffer(gl.DRAW_FRAMEBUFFER, drawn);
      gl.bindFramebuffer(gl.READ_FRAMEBUFFER, read);
    }
  };

  const start = (canvas) => {
    const gl = canvas.getContext("webgl2");
    const program = gl && gl.getContextAttributes().preserveDrawingBuffer ? programOf(gl) : null;
    if (!program) return;
    const [none, places] = [gl.createVertexArray(), ["depth", "reversed", "radius"].map((name) => gl.getUniformLocation(program, name))];
    let copy = null;
    let isDrawn = false; // whether the canvas has a new picture, which has no shade yet
    let isAble = true;

    const shade = () => {
      const { drawingBufferWidth: width, drawingBufferHeight: height } = gl;
      if (copy?.width !== width || copy?.height !== height) {
        if (copy) remove(gl, copy);
        copy = copyOf(gl, width, height);
        if (!copy) return void (isAble = false);
      } else fill(gl, copy);
      gl.bindFramebuffer(gl.FRAMEBUFFER, null);
      gl.viewport(0, 0, width, height);
      gl.enable(gl.BLEND);
      gl.blendEquation(gl.FUNC_ADD);
      gl.blendFunc(gl.ZERO, gl.SRC_COLOR); // the picture times the shade
      gl.colorMask(true, true, true, false);
      gl.useProgram(program);
      gl.bindVertexArray(none);
      gl.bindTexture(gl.TEXTURE_2D, copy.texture);
      gl.bindSampler(0, null);
      gl.uniform1i(places[0], 0);
      gl.uniform1i(places[1], gl.getParameter(gl.DEPTH_CLEAR_VALUE) === 0);
      gl.uniform1f(places[2], RADIUS * devicePixelRatio);
      gl.drawArrays(gl.TRIANGLES, 0, 3);
    };

    const clear = gl.clear;
    gl.clear = (bits) => {
      isDrawn ||= Boolean(bits & gl.COLOR_BUFFER_BIT) && gl.getParameter(gl.DRAW_FRAMEBUFFER_BINDING) === null;
      clear.call(gl, bits);
    };
    const request = window.requestAnimationFrame;
    window.requestAnimationFrame = (draw) => request((time) => {
      draw(time);
      if (!isDrawn || !isAble || gl.isContextLost()) return;
      isDrawn = false;
      keepingState(gl, shade);
    });
  };

  const find = () => {
    const canvas = document.querySelector('canvas[data-engine^="three.js"]'); // another one has another kind of context
    if (canvas) start(canvas);
    else setTimeout(find, 200);
  };
  find();
})();
