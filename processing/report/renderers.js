// How a light field is drawn: WebGL2, or a plain 2D canvas where that is missing. No framework.
//
// Coordinates: a viewpoint (x, y) is in view steps from the centre view, x to the right, y down. A point at p in the
// centre view, with disparity d [px per step], is at p - (x, y) * d seen from there. `gain` stretches the viewpoint
// beyond the recorded ones along the disparity; 1 shows the light field as it is.
"use strict";
const lightFieldRenderers = (() => {
  const clamp = (value, low, high) => Math.min(high, Math.max(low, value));

  const loadImage = (uri) => new Promise((resolve, reject) => {
    const image = new Image();
    image.onload = () => resolve(image);
    image.onerror = () => reject(new Error("a picture cannot be decoded"));
    image.src = uri;
  });

  // One view's worth of `image`, from (x, y), on a canvas of its own.
  const cut = (image, data, x, y) => {
    const tile = document.createElement("canvas");
    tile.width = data.width;
    tile.height = data.height;
    const pen = tile.getContext("2d", { willReadFrequently: true });
    pen.drawImage(image, x, y, data.width, data.height, 0, 0, data.width, data.height);
    return tile;
  };

  // The disparity of the centre view: 0..255 between data.low and data.high.
  const levelsOf = (image, data) => {
    const rgba = cut(image, data, 0, 0).getContext("2d").getImageData(0, 0, data.width, data.height).data;
    return new Uint8Array(data.width * data.height).map((_, i) => rgba[4 * i]);
  };
  const disparityAt = (levels, data, x, y) => {
    const column = clamp(Math.round(x), 0, data.width - 1);
    const row = clamp(Math.round(y), 0, data.height - 1);
    return data.low + ((data.high - data.low) * levels[row * data.width + column]) / 255;
  };
  // The disparity d of what is at (px, py) seen from (sx, sy): the fixed point of d = centre(p + s d).
  const disparityFrom = (levels, data, px, py, sx, sy) => {
    let d = disparityAt(levels, data, px, py);
    for (let i = 0; i < 6; i++) d = disparityAt(levels, data, px + sx * d, py + sy * d);
    return d;
  };

  const VERTEX = `#version 300 es
    void main() { vec2 p = vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4. - 1.; gl_Position = vec4(p, 0, 1); }`;
  const FRAGMENT = `#version 300 es
    precision highp float; precision highp int; precision highp sampler2DArray;
    uniform sampler2DArray views; uniform sampler2D disparity;
    uniform vec2 size, eye, range; uniform ivec2 grid; uniform ivec4 window;
    uniform float focus, aperture, gain;
    out vec4 colour;
    float centre(vec2 p) { return mix(range.x, range.y, texture(disparity, (p + .5) / size).r); }
    float seenFrom(vec2 p, vec2 s) { float d = centre(p); for (int i = 0; i < 5; i++) d = centre(p + s * d); return d; }
    vec3 view(ivec2 v, vec2 p, float blur) {
      return textureLod(views, vec3((p + .5) / size, float(v.y * grid.x + v.x)), blur).rgb;
    }
    // Through a pinhole: the four views around the eye, each looked up where the point lies in it.
    vec3 pinhole(vec2 p) {
      vec2 middle = vec2(grid - 1) * .5, at = clamp(eye + middle, vec2(0), vec2(grid - 1));
      ivec2 low = clamp(ivec2(floor(at)), ivec2(0), grid - 2);
      vec2 f = at - vec2(low);
      float d = seenFrom(p, gain * eye);
      vec3 sum = vec3(0);
      for (int i = 0; i < 4; i++) {
        ivec2 corner = ivec2(i & 1, i >> 1), v = low + corner;
        vec2 w = mix(1. - f, f, vec2(corner));
        sum += w.x * w.y * view(v, p + (gain * eye - (vec2(v) - middle)) * d, 0.);
      }
      return sum;
    }
    // Through an aperture: every view inside it, shifted so that the focal disparity coincides. What is out of focus
    // is read from a coarser level, as wide as the gap between two views' copies, so that they melt into one blur.
    vec3 synthetic(vec2 p) {
      vec2 middle = vec2(grid - 1) * .5;
      float blur = log2(max(1., gain * abs(seenFrom(p, gain * eye) - focus)));
      vec4 sum = vec4(0);
      for (int y = window.y; y <= window.w; y++) for (int x = window.x; x <= window.z; x++) {
        vec2 v = vec2(x, y) - middle;
        float w = smoothstep(aperture + .5, aperture - .5, length(v - eye));
        if (w <= 0.) continue;
        vec2 q = p + gain * (eye - v) * focus;
        if (gain != 1.) q += (gain - 1.) * v * seenFrom(q, gain * v);
        sum += w * vec4(view(ivec2(x, y), q, blur), 1);
      }
      return sum.rgb / max(sum.a, 1e-6);
    }
    void main() {
      vec2 p = vec2(gl_FragCoord.x, size.y - gl_FragCoord.y) - .5;
      float open = smoothstep(.3, .9, aperture);
      vec3 light = open < 1. ? pinhole(p) : vec3(0);
      if (open > 0.) light = mix(light, synthetic(p), open);
      vec3 s = mix(12.92 * light, 1.055 * pow(max(light, 1e-6), vec3(1. / 2.4)) - .055, step(.0031308, light));
      colour = vec4(s, 1);
    }`;

  function compile(gl) {
    const program = gl.createProgram();
    for (const [kind, source] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    return gl.getProgramParameter(program, gl.LINK_STATUS) ? program : null;
  }

  function upload(gl, data, atlas, levels) {
    const { width, height } = data, count = data.rows * data.cols;
    const filter = (target, smaller) => {
      gl.texParameteri(target, gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE);
      gl.texParameteri(target, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
      gl.texParameteri(target, gl.TEXTURE_MAG_FILTER, gl.LINEAR);
      gl.texParameteri(target, gl.TEXTURE_MIN_FILTER, smaller);
    };
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D_ARRAY, gl.createTexture());
    // sRGB textures: blending and blurring happen in linear light, as in a lens.
    const levelsOfDetail = Math.min(5, 1 + Math.floor(Math.log2(Math.max(width, height))));
    gl.texStorage3D(gl.TEXTURE_2D_ARRAY, levelsOfDetail, gl.SRGB8_ALPHA8, width, height, count);
    for (let i = 0; i < count; i++) {
      const tile = cut(atlas, data, (i % data.cols) * width, Math.floor(i / data.cols) * height);
      gl.texSubImage3D(gl.TEXTURE_2D_ARRAY, 0, 0, 0, i, width, height, 1, gl.RGBA, gl.UNSIGNED_BYTE, tile);
    }
    gl.generateMipmap(gl.TEXTURE_2D_ARRAY);
    filter(gl.TEXTURE_2D_ARRAY, gl.LINEAR_MIPMAP_LINEAR);
    gl.activeTexture(gl.TEXTURE1);
    gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.R8, width, height, 0, gl.RED, gl.UNSIGNED_BYTE, levels);
    filter(gl.TEXTURE_2D, gl.LINEAR);
  }

  // A renderer, or null where WebGL2 is missing or too small.
  function webgl(canvas, data, atlas, levels) {
    const gl = canvas.getContext("webgl2", { antialias: false, alpha: false });
    if (!gl || data.rows * data.cols > gl.getParameter(gl.MAX_ARRAY_TEXTURE_LAYERS)) return null;
    const program = compile(gl);
    if (!program) return null;
    upload(gl, data, atlas, levels);
    gl.useProgram(program);
    const at = (name) => gl.getUniformLocation(program, name);
    gl.uniform1i(at("views"), 0);
    gl.uniform1i(at("disparity"), 1);
    gl.uniform2f(at("size"), data.width, data.height);
    gl.uniform2f(at("range"), data.low, data.high);
    gl.uniform2i(at("grid"), data.cols, data.rows);
    const [eye, focus, aperture, gain, around] = ["eye", "focus", "aperture", "gain", "window"].map(at);
    const middle = { x: (data.cols - 1) / 2, y: (data.rows - 1) / 2 };
    return {
      name: "webgl2",
      draw(state) {
        const reach = state.aperture + 0.5;
        const first = (value) => Math.max(0, Math.ceil(value - reach));
        const last = (value, end) => Math.min(end, Math.floor(value + reach));
        const [x, y] = [state.x + middle.x, state.y + middle.y];
        gl.viewport(0, 0, data.width, data.height);
        gl.uniform2f(eye, state.x, state.y);
        gl.uniform1f(focus, state.focus);
        gl.uniform1f(aperture, state.aperture);
        gl.uniform1f(gain, state.gain);
        gl.uniform4i(around, first(x), first(y), last(x, data.cols - 1), last(y, data.rows - 1));
        gl.drawArrays(gl.TRIANGLES, 0, 3);
      },
    };
  }

  // Whole views, shifted and averaged: no disparity per pixel, so no gain.
  function plain(canvas, data, atlas) {
    const pen = canvas.getContext("2d");
    const { width, height } = data;
    return {
      name: "canvas",
      draw(state) {
        const closed = state.aperture < 0.7;
        let total = 0;
        for (let i = 0; i < data.rows * data.cols; i++) {
          const col = i % data.cols, row = Math.floor(i / data.cols);
          const dx = col - (data.cols - 1) / 2 - state.x, dy = row - (data.rows - 1) / 2 - state.y;
          const weight = closed
            ? Math.max(0, 1 - Math.abs(dx)) * Math.max(0, 1 - Math.abs(dy))
            : clamp(state.aperture + 0.5 - Math.hypot(dx, dy), 0, 1);
          if (weight < 0.001) continue;
          total += weight;
          pen.globalAlpha = weight / total; // a running mean
          const [sx, sy] = closed ? [0, 0] : [dx * state.focus, dy * state.focus];
          pen.drawImage(atlas, col * width, row * height, width, height, sx, sy, width, height);
        }
      },
    };
  }

  return { clamp, loadImage, levelsOf, disparityFrom, webgl, plain };
})();
