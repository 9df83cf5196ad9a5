// The draggable light field: state, controls, pointer, keyboard, address. renderers.js draws it.
//
// The address can set the state: report.html#view=2,-1&focus=0.3&aperture=1.5&gain=1&renderer=canvas&bare
// (view in view steps from the centre, x right, y down; focus in px per view step; bare = the picture alone, 1:1).
// <html data-viewer="webgl2|canvas|failed"> says that it is ready, data-viewpoint, data-focus, data-aperture where it is.
(() => {
  "use strict";
  const root = document.documentElement;
  const block = document.getElementById("light-field");
  const host = document.querySelector(".viewer");
  if (!block || !host) return;
  const { clamp, loadImage, levelsOf, disparityFrom, webgl, plain } = lightFieldRenderers;
  const data = JSON.parse(block.textContent);
  const half = { x: (data.cols - 1) / 2, y: (data.rows - 1) / 2 };
  const widest = Math.max(half.x, half.y);
  const OPENED = Math.min(2.5, widest); // aperture that a click opens a pinhole to, else focus would change nothing
  const find = (selector) => host.querySelector(selector);
  const pad = find(".pad"), swayButton = find('[data-do="sway"]');
  const still = matchMedia("(prefers-reduced-motion: reduce)").matches;
  let canvas = find("canvas");

  // ---- state ---------------------------------------------------------------------------------------------------------
  const initial = () => ({ x: 0, y: 0, focus: clamp(0, data.low, data.high), aperture: 0, gain: data.gain });
  const state = initial();
  let renderer = null, levels = null, dirty = true, visible = true, swayingSince = null, easing = null;

  function set(changes) {
    Object.assign(state, changes);
    state.x = clamp(state.x, -half.x, half.x);
    state.y = clamp(state.y, -half.y, half.y);
    state.focus = clamp(state.focus, data.low, data.high);
    state.aperture = clamp(state.aperture, 0, widest + 0.5);
    state.gain = clamp(state.gain, 1, data.maxGain);
    dirty = true; // drawn with the next frame
    if (renderer) show();
  }
  function sway(on) {
    swayingSince = on ? performance.now() : null;
    swayButton.setAttribute("aria-pressed", String(on));
  }
  const takeOver = () => { sway(false); easing = null; };
  const refocus = (px, py) => {
    const focus = disparityFrom(levels, data, px, py, state.gain * state.x, state.gain * state.y);
    const aperture = state.aperture < 0.7 ? OPENED : state.aperture;
    if (still) set({ focus, aperture });
    else easing = { start: performance.now(), from: { ...state }, to: { focus, aperture } };
  };

  function frame(now) {
    requestAnimationFrame(frame);
    if (!visible) return;
    if (swayingSince !== null) {
      const turn = (now - swayingSince) / 900, grow = clamp((now - swayingSince) / 1500, 0, 1);
      set({ x: 0.85 * half.x * grow * Math.sin(turn), y: 0.35 * half.y * grow * Math.sin(turn * 0.8) });
    }
    if (easing) {
      const t = clamp((now - easing.start) / 280, 0, 1), smooth = t * t * (3 - 2 * t);
      const mix = (name) => easing.from[name] + smooth * (easing.to[name] - easing.from[name]);
      set({ focus: mix("focus"), aperture: mix("aperture") });
      if (t === 1) easing = null;
    }
    if (dirty) draw();
  }
  function draw() {
    dirty = false;
    renderer.draw(state);
  }

  // ---- what is shown beside the picture ------------------------------------------------------------------------------
  const sliders = {}, outputs = {};
  const distance = (disparity) => {
    if (!data.bf || !data.focusDistance) return "";
    const inverse = (disparity * data.perPixel) / data.bf + 1 / data.focusDistance;
    return inverse > 0.01 ? ` · ${(1 / inverse).toPrecision(3)} ${data.unit}` : " · far away";
  };
  function show() {
    const focus = state.focus * data.perPixel;
    const words = {
      focus: `${focus.toFixed(2).replace("-", "−")} px${distance(state.focus)}`,
      aperture: state.aperture < 0.3 ? "pinhole" : `⌀ ${(2 * state.aperture).toFixed(1)} views`,
      gain: state.gain === 1 ? "true" : `×${state.gain.toFixed(1)} exaggerated`,
    };
    for (const name of Object.keys(sliders)) {
      outputs[name].textContent = words[name];
      sliders[name].value = state[name];
      sliders[name].setAttribute("aria-valuetext", words[name]);
    }
    const eye = pad.querySelector(".eye");
    eye.setAttribute("cx", state.x);
    eye.setAttribute("cy", state.y);
    eye.setAttribute("r", Math.max(0.28, state.aperture));
    root.dataset.viewpoint = `${state.x.toFixed(2)},${state.y.toFixed(2)}`;
    root.dataset.focus = focus.toFixed(3);
    root.dataset.aperture = state.aperture.toFixed(2);
  }
  function drawPad() {
    const dots = [];
    for (let i = 0; i < data.rows * data.cols; i++) {
      dots.push(`<circle cx="${(i % data.cols) - half.x}" cy="${Math.floor(i / data.cols) - half.y}" r=".09"/>`);
    }
    const side = widest + 0.9;
    pad.innerHTML = `<svg viewBox="${-side} ${-side} ${2 * side} ${2 * side}">${dots.join("")}<circle class="eye" r=".3"/></svg>`;
  }
  function bindSliders() {
    const ranges = { focus: [data.low, data.high], aperture: [0, widest + 0.5], gain: [1, data.maxGain] };
    for (const label of host.querySelectorAll("[data-for]")) {
      const name = label.dataset.for, slider = label.querySelector("input");
      sliders[name] = slider;
      outputs[name] = label.querySelector("output");
      [slider.min, slider.max] = ranges[name];
      slider.addEventListener("input", () => {
        easing = null;
        set({ [name]: Number(slider.value) });
        if (name === "focus" && state.aperture < 0.7) set({ aperture: OPENED });
      });
    }
    swayButton.addEventListener("click", () => sway(swayingSince === null));
    find('[data-do="reset"]').addEventListener("click", () => { takeOver(); set(initial()); });
  }

  // ---- pointer, wheel, keyboard --------------------------------------------------------------------------------------
  const place = (event) => {
    const box = canvas.getBoundingClientRect();
    return [((event.clientX - box.left) / box.width) * data.width - 0.5,
      ((event.clientY - box.top) / box.height) * data.height - 0.5];
  };
  function bindPointer() {
    const fingers = new Map();
    let travelled = 0, pinch = null;
    const gap = () => { const [a, b] = [...fingers.values()]; return Math.hypot(a[0] - b[0], a[1] - b[1]); };
    canvas.addEventListener("pointerdown", (event) => {
      takeOver();
      if (!fingers.size) travelled = 0;
      fingers.set(event.pointerId, [event.clientX, event.clientY]);
      if (event.isTrusted) canvas.setPointerCapture(event.pointerId); // a scripted event has no pointer to capture
      pinch = fingers.size === 2 ? { gap: gap(), aperture: state.aperture } : null;
    });
    canvas.addEventListener("pointermove", (event) => {
      const before = fingers.get(event.pointerId);
      if (!before) return;
      const dx = event.clientX - before[0], dy = event.clientY - before[1];
      fingers.set(event.pointerId, [event.clientX, event.clientY]);
      travelled += Math.hypot(dx, dy);
      if (pinch) {
        set({ aperture: pinch.aperture + ((gap() - pinch.gap) / canvas.clientWidth) * 2 * widest });
      } else if (fingers.size === 1 && travelled > 3) {
        // What is near follows the pointer, so the eye goes the other way.
        set({ x: state.x - (2.4 * half.x * dx) / canvas.clientWidth,
          y: state.y - (2.4 * half.y * dy) / canvas.clientHeight });
      }
    });
    const lift = (event) => {
      if (!fingers.delete(event.pointerId)) return;
      if (event.type === "pointerup" && !fingers.size && !pinch && travelled <= 3) refocus(...place(event));
      if (!fingers.size) pinch = null;
    };
    canvas.addEventListener("pointerup", lift);
    canvas.addEventListener("pointercancel", lift);
    canvas.addEventListener("wheel", (event) => {
      if (document.activeElement !== canvas) return; // the page scrolls until the viewer is in use
      event.preventDefault();
      takeOver();
      set({ aperture: state.aperture - Math.sign(event.deltaY) * 0.25 });
    }, { passive: false });
  }
  function bindKeys() {
    const step = (data.high - data.low) / 40;
    const move = (x, y) => set({ x: state.x + x, y: state.y + y });
    const open = (by) => set({ aperture: state.aperture + by });
    const keys = {
      ArrowLeft: () => move(-0.25, 0), ArrowRight: () => move(0.25, 0),
      ArrowUp: () => move(0, -0.25), ArrowDown: () => move(0, 0.25),
      "+": () => open(0.25), "=": () => open(0.25), "-": () => open(-0.25),
      "]": () => set({ focus: state.focus + step }), "[": () => set({ focus: state.focus - step }),
      Home: () => set(initial()),
    };
    canvas.addEventListener("keydown", (event) => {
      if (event.ctrlKey || event.metaKey || event.altKey) return;
      if (event.key === " ") sway(swayingSince === null);
      else if (keys[event.key]) { takeOver(); keys[event.key](); } else return;
      event.preventDefault();
    });
  }

  // ---- the address; returns whether it asks for anything -------------------------------------------------------------
  function follow() {
    const asked = new URLSearchParams(location.hash.slice(1));
    const changes = {};
    const view = (asked.get("view") || "").split(",").map(Number);
    if (view.length === 2 && view.every(Number.isFinite)) Object.assign(changes, { x: view[0], y: view[1], gain: 1 });
    for (const name of ["focus", "aperture", "gain"]) {
      const value = asked.has(name) ? Number(asked.get(name)) : NaN;
      if (Number.isFinite(value)) changes[name] = name === "focus" ? value / data.perPixel : value;
    }
    root.classList.toggle("bare", asked.has("bare"));
    if (Object.keys(changes).length) { takeOver(); set(changes); }
    return Object.keys(changes).length > 0 || asked.has("bare");
  }

  async function start() {
    const [atlas, picture] = await Promise.all([loadImage(data.atlas), loadImage(data.disparity)]);
    levels = levelsOf(picture, data);
    const wanted = new URLSearchParams(location.hash.slice(1)).get("renderer");
    renderer = wanted === "canvas" ? null : webgl(canvas, data, atlas, levels);
    if (!renderer) {
      // A canvas that WebGL was tried on gives no 2D context: take a fresh one.
      const fresh = canvas.cloneNode();
      canvas.replaceWith(fresh);
      canvas = fresh;
      renderer = plain(canvas, data, atlas);
      state.gain = data.gain = data.maxGain = 1;
      find('[data-for="gain"]').hidden = true;
    }
    drawPad();
    bindSliders();
    bindPointer();
    bindKeys();
    const asked = follow();
    addEventListener("hashchange", follow);
    canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
    canvas.addEventListener("webglcontextrestored", () => { renderer = webgl(canvas, data, atlas, levels); dirty = true; });
    new IntersectionObserver(([entry]) => { visible = entry.isIntersecting; }).observe(host);
    draw();
    show();
    canvas.hidden = false;
    host.classList.add("ready");
    root.dataset.viewer = renderer.name;
    if (!asked && !still) sway(true);
    requestAnimationFrame(frame);
  }
  start().catch((error) => {
    // The still picture stays; say why it cannot be dragged.
    root.dataset.viewer = "failed";
    find(".help").textContent = `The viewer could not start: ${error.message}`;
  });
})();
