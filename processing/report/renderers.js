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
  // The disparity d of what is seen at (px, py) from (sx, sy): the nearest solution of d = centre(p + s d), found by
  // walking from the nearest possible d to the farthest in steps of less than a pixel. Where there is none, something
  // comes into view that the centre does not see: the farthest surface along the walk stands in for it.
  const disparityFrom = (levels, data, px, py, sx, sy) => {
    const span = data.high - data.low, steps = clamp(Math.ceil(1.5 * Math.hypot(sx, sy) * span), 1, 32);
    const step = span / steps;
    let farthest = data.high;
    for (let i = 0; i <= steps; i++) {
      let d = data.high - i * step;
      const found = disparityAt(levels, data, px + sx * d, py + sy * d);
      farthest = Math.min(farthest, found);
      if (Math.abs(found - d) > step) continue;
      for (let k = 0; k < 4; k++) {
        d += clamp(disparityAt(levels, data, px + sx * d, py + sy * d) - d, -step, step);
      }
      return d;
    }
    return farthest;
  };

  const VERTEX = `#version 300 es
    void main() { vec2 p = vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4. - 1.; gl_Position = vec4(p, 0, 1); }`;
  const FRAGMENT = `#version 300 es
    precision highp float; precision highp int; precision highp sampler2DArray;
    uniform sampler2DArray views; uniform sampler2D disparity;
    uniform vec2 size, eye, range; uniform ivec2 grid; uniform ivec4 window;
    uniform float focus, aperture, gain;
    out vec4 colour;
    // Not interpolated: between two surfaces there is none.
    float centre(vec2 p) {
      ivec2 at = clamp(ivec2(round(p)), ivec2(0), ivec2(size) - 1);
      return mix(range.x, range.y, texelFetch(disparity, at, 0).r);
    }
    // As disparityFrom above. Returns the disparity, and in xy the place in the centre view that shows the point:
    // where the centre does not see it, the neighbouring place of the surface that stands in for it.
    vec3 seenFrom(vec2 p, vec2 s) {
      float span = range.y - range.x;
      int steps = int(clamp(ceil(1.5 * length(s) * span), 1., 32.));
      float unit = span / float(steps);
      vec3 farthest = vec3(p, range.y);
      for (int i = 0; i <= steps; i++) {
        float d = range.y - float(i) * unit, found = centre(p + s * d);
        if (found <= farthest.z) farthest = vec3(p + s * d, found);
        if (abs(found - d) > unit) continue;
        for (int k = 0; k < 4; k++) d += clamp(centre(p + s * d) - d, -unit, unit);
        return vec3(p + s * d, d);
      }
      return farthest;
    }
    // Good enough where blur hides the rest, and much cheaper.
    float roughlyFrom(vec2 p, vec2 s) { float d = centre(p); for (int i = 0; i < 3; i++) d = centre(p + s * d); return d; }
    vec3 view(ivec2 v, vec2 p, float blur) {
      return textureLod(views, vec3((p + .5) / size, float(v.y * grid.x + v.x)), blur).rgb;
    }
    // Through a pinhole: the four views around the eye, each looked up where the point lies in it.
    vec3 pinhole(vec2 p) {
      vec2 middle = vec2(grid - 1) * .5, at = clamp(eye + middle, vec2(0), vec2(grid - 1));
      ivec2 low = clamp(ivec2(floor(at)), ivec2(0), grid - 2);
      vec2 f = at - vec2(low);
      vec3 seen = seenFrom(p, gain * eye);
      // At its own viewpoint a view shows what the centre does not see; beyond it nothing does.
      vec2 source = gain > 1.001 ? seen.xy : p + gain * eye * seen.z;
      vec3 sum = vec3(0);
      for (int i = 0; i < 4; i++) {
        ivec2 corner = ivec2(i & 1, i >> 1), v = low + corner;
        vec2 w = mix(1. - f, f, vec2(corner));
        sum += w.x * w.y * view(v, source - (vec2(v) - middle) * seen.z, 0.);
      }
      return sum;
    }
    // Through an aperture: every view inside it, shifted so that the focal disparity coincides. What is out of focus
    // is read from a coarser level, as wide as the gap between two views' copies, so that they melt into one blur.
    vec3 synthetic(vec2 p) {
      vec2 middle = vec2(grid - 1) * .5;
      float blur = log2(max(1., gain * abs(roughlyFrom(p, gain * eye) - focus)));
      vec4 sum = vec4(0);
      for (int y = window.y; y <= window.w; y++) for (int x = window.x; x <= window.z; x++) {
        vec2 v = vec2(x, y) - middle;
        float w = smoothstep(aperture + .5, aperture - .5, length(v - eye));
        if (w <= 0.) continue;
        vec2 q = p + gain * (eye - v) * focus;
        if (gain != 1.) q += (gain - 1.) * v * roughlyFrom(q, gain * v);
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
    filter(gl.TEXTURE_2D, gl.NEAREST);
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
    const { width, height } = data;
    const layers = [canvas.getContext("2d")];
    const layer = (depth) => (layers[depth] ??= cut(atlas, data, 0, 0).getContext("2d"));
    // The weighted mean of `copies` on layer(depth); returns their weight. Halves are averaged with halves, because
    // eight bits would swallow the small weights of a running mean.
    function average(copies, depth) {
      const pen = layer(depth);
      if (copies.length === 1) {
        const [col, row, dx, dy, weight] = copies[0];
        pen.globalAlpha = 1;
        // Unshifted first, so that the border which the shift uncovers is not empty.
        for (const [x, y] of [[0, 0], [dx, dy]]) {
          pen.drawImage(atlas, col * width, row * height, width, height, x, y, width, height);
        }
        return weight;
      }
      const middle = copies.length >> 1;
      const first = average(copies.slice(0, middle), depth), second = average(copies.slice(middle), depth + 1);
      pen.globalAlpha = second / (first + second);
      pen.drawImage(layer(depth + 1).canvas, 0, 0);
      return first + second;
    }
    return {
      name: "canvas",
      draw(state) {
        const closed = state.aperture < 0.7;
        const copies = [];
        for (let i = 0; i < data.rows * data.cols; i++) {
          const col = i % data.cols, row = Math.floor(i / data.cols);
          const dx = col - (data.cols - 1) / 2 - state.x, dy = row - (data.rows - 1) / 2 - state.y;
          const weight = closed
            ? Math.max(0, 1 - Math.abs(dx)) * Math.max(0, 1 - Math.abs(dy))
            : clamp(state.aperture + 0.5 - Math.hypot(dx, dy), 0, 1);
          const focus = closed ? 0 : state.focus;
          if (weight > 0.001) copies.push([col, row, dx * focus, dy * focus, weight]);
        }
        average(copies, 0);
      },
    };
  }

  return { clamp, loadImage, levelsOf, disparityFrom, webgl, plain };
})();
