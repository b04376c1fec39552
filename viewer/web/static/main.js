// The page: unpacks the scene, draws it when something moves, and wires up buttons.
import { Camera } from "./camera.js";
import { Controls } from "./controls.js";
import { Overlay } from "./overlay.js";
import { Renderer } from "./renderer.js";
import { Resolution } from "./resolution.js";
import { sceneOf, unpack } from "./scene.js";
import { cross, dot, mix, norm, scaled } from "./vectors.js";

const NAMES = {
  normal: "Picture", diffuse: "Diffuse", features: "Features", "view-dependent": "Reflections", depth: "Depth", normals: "Normals",
};
const BACKGROUNDS = { Gradient: null, White: [1, 1, 1], Grey: [0.5, 0.5, 0.5], Black: [0, 0, 0] };
const REST_MS = 120; // without movement, before the sharp picture is begun
const SHARPEST = 2; // pixels of a screen pixel that is larger than others, at most
const ASK_MS = 2000; // between questions for a newer scene
const COARSE = "#coarse"; // of the address: the last attempt to show more ended with the graphics driver
const SHARES = ["", "half", "a quarter of its", "an eighth of its"];
const CALM = matchMedia("(prefers-reduced-motion: reduce)"); // then views change at once
const TURNTABLE = 0.6; // of a picture's height that a second's dragging would be

const { read, fail } = globalThis.snerg;
/** @returns {any} */
const element = (id) => document.getElementById(id);
const canvas = element("view");
const settings = { mode: "normal", background: null, surroundings: true };
const resolution = new Resolution();
const overlay = new Overlay(element("overlay"));
const player = { playing: false, seconds: 0 };
let [scene, camera, controls, gl] = [null, null, null, null];
let renderer = null; // of the finest level that is there
let near = 0;

// Frames. `changed`: what is on the canvas is of yesterday. `tiles`: what is left of the sharp picture; null before it is begun.
let [frame, changed, tiles, restAt, last] = [0, true, null, 0, 0];

function touch() {
  changed = true;
  request();
}

function request() {
  if (!frame && renderer) frame = requestAnimationFrame(tick);
}

function tick(now) {
  frame = 0;
  const seconds = Math.min((now - last) / 1000, 0.1);
  last = now;
  controls.update(seconds);
  const played = play(seconds);
  if (camera.update(CALM.matches ? Infinity : seconds) || played || controls.keys.size || changed) {
    changed = false;
    const size = resolution.size(canvas.width, canvas.height);
    timed(size, [0, 0, ...size], true);
    renderer.show(...size);
    overlay.draw(camera.view(near));
    restAt = now + REST_MS;
    tiles = size[0] === canvas.width && size[1] === canvas.height ? [] : null;
    return request();
  }
  if (now < restAt) return request();
  if (tiles === null) tiles = resolution.tiles(canvas.width, canvas.height);
  if (tiles.length) {
    const size = [canvas.width, canvas.height];
    timed(size, tiles.shift(), false);
    if (tiles.length) return request();
    renderer.show(...size);
  }
  const view = camera.view(near);
  for (const place of overlay.places) place.covered = renderer.covers(view, settings, place.point);
  overlay.draw(view);
}

function timed(size, box, moving) {
  const start = performance.now();
  renderer.draw(camera.view(near), settings, ...size, box);
  renderer.finish();
  resolution.measured(box[2] * box[3], performance.now() - start, moving);
}

// The camera path, or a turntable; whether it moves.
function play(seconds) {
  if (!player.playing) return false;
  const { path } = scene;
  if (!path) camera.orbit(-TURNTABLE * seconds, 0);
  else {
    player.seconds += seconds;
    const count = path.frames.length;
    const at = player.seconds * path.fps;
    if (!path.closed && at >= count - 1) setPlaying(false);
    const row = (index) => path.frames[path.closed ? index % count : Math.min(index, count - 1)];
    camera.held = between(row(Math.floor(at)), row(Math.floor(at) + 1), at % 1);
  }
  return true;
}

// The view between two rows of a camera path: 3 x 4 numbers, row-major, and the field of view.
function between(a, b, share) {
  const row = mix(a, b, share);
  const column = (j) => [row[j], row[4 + j], row[8 + j]];
  const unit = (v) => scaled(v, 1 / norm(v));
  const back = unit(column(2));
  const right = unit(cross(column(1), back));
  const handed = dot(right, column(0)) < 0 ? -1 : 1;
  const axes = [scaled(right, handed), cross(back, right), back];
  return { axes, eye: column(3), fov: row[12] };
}

function setPlaying(playing) {
  if (playing) player.seconds = 0;
  player.playing = playing;
  element("play").setAttribute("aria-pressed", String(playing));
}

// Buttons and commands

const commands = {
  reset() { setPlaying(false); element("note").hidden = true; camera.reset(); },
  play() { if (!element("play").hidden) setPlaying(!player.playing); },
  background() {
    const names = Object.keys(BACKGROUNDS);
    const at = names.findIndex((name) => String(BACKGROUNDS[name]) === String(settings.background));
    setBackground(BACKGROUNDS[names[(at + 1) % names.length]]);
  },
  mode(index) { if (Object.keys(scene.shaders.modes)[index]) setMode(Object.keys(scene.shaders.modes)[index]); },
  fullscreen() {
    if (document.fullscreenElement) document.exitFullscreen();
    else document.documentElement.requestFullscreen?.().catch(() => {});
  },
  hide() { document.body.classList.toggle("quiet"); },
  help() { open("keys"); },
  display() { open("panel"); },
  close() {
    document.body.classList.remove("quiet");
    element("note").hidden = true;
    open(null);
  },
  save() {
    const picture = document.createElement("canvas");
    [picture.width, picture.height] = [canvas.width, canvas.height];
    picture.getContext("2d").putImageData(renderer.picture(camera.view(near), settings, canvas.width, canvas.height), 0, 0);
    picture.toBlob((blob) => {
      const link = document.createElement("a");
      link.href = URL.createObjectURL(blob);
      link.download = `${scene.title || "scene"}.png`;
      link.click();
      setTimeout(() => URL.revokeObjectURL(link.href), 60000);
    });
  },
};

const sections = { panel: "display", keys: "help" };

// Opens a section, or closes it where it is open already; the others close.
function open(id) {
  for (const [section, button] of Object.entries(sections)) {
    const shown = section === id && element(section).hidden;
    element(section).hidden = !shown;
    element(button).setAttribute("aria-expanded", String(shown));
  }
  element("bookmarks").hidden = !scene.camera.bookmarks.length || Object.keys(sections).some((each) => !element(each).hidden);
}

function setMode(mode) {
  settings.mode = mode;
  for (const button of element("modes").children) button.setAttribute("aria-checked", String(button.value === mode));
  touch();
}

function setBackground(colour) {
  settings.background = colour;
  for (const button of element("backgrounds").children)
    button.setAttribute("aria-checked", String(button.value === String(colour)));
  touch();
}

function button(parent, { text = "", title = "", value = "" }, action) {
  const made = document.createElement("button");
  Object.assign(made, { textContent: text, title, value });
  if (parent.getAttribute("role") === "radiogroup") made.setAttribute("role", "radio");
  made.addEventListener("click", action);
  parent.append(made);
  return made;
}

function buildInterface() {
  for (const name of ["reset", "play", "display", "save", "fullscreen", "help"])
    element(name).addEventListener("click", () => { commands[name](); touch(); });
  for (const [title, colour] of Object.entries(BACKGROUNDS)) {
    const swatch = button(element("backgrounds"), { title, value: String(colour) }, () => setBackground(colour));
    const css = (rgb) => `rgb(${rgb.map((v) => Math.round(255 * v)).join()})`;
    swatch.style.background = colour ? css(colour) : `linear-gradient(${scene.shaders.backdropColours.map(css).join()})`;
  }
  const picker = document.createElement("input");
  Object.assign(picker, { type: "color", title: "Another colour" });
  picker.addEventListener("input", () => setBackground([1, 3, 5].map((i) => parseInt(picker.value.slice(i, i + 2), 16) / 255)));
  element("backgrounds").append(picker);
  element("measurements").addEventListener("change", () => { element("overlay").style.display = element("measurements").checked ? "" : "none"; });
  element("surroundings").addEventListener("change", () => { settings.surroundings = element("surroundings").checked; touch(); });
  element("near").addEventListener("input", () => {
    near = element("near").value * 2 * scene.camera.radius;
    touch();
  });
  element("fullscreen").hidden = !document.fullscreenEnabled; // as on iPhones, and in frames that do not allow it
  if (scene.camera.bounded) [element("drag").textContent, element("slide").textContent] = ["move", "turn a little"];
  element("note").addEventListener("click", () => { element("note").hidden = getSelection().isCollapsed; }); // or it is copied
  setBackground(settings.background);
}

// What the interface shows of the scene, which may be replaced.
function describe() {
  const { title, credits, path, measurements, contracted, ndc, camera: { bookmarks, bounded } } = scene;
  document.title = element("title").textContent = title;
  element("credits").textContent = credits;
  element("play").title = path ? "Play the camera path (space)" : "Turntable (space)";
  element("play").hidden = !path && bounded;
  element("modes").replaceChildren();
  for (const mode of Object.keys(scene.shaders.modes)) button(element("modes"), { text: NAMES[mode], value: mode }, () => setMode(mode));
  element("bookmarks").replaceChildren();
  for (const bookmark of bookmarks) button(element("bookmarks"), { text: bookmark.name, title: bookmark.name }, () => visit(bookmark));
  element("note").hidden = true;
  element("around").hidden = !contracted;
  element("measured").hidden = !measurements.length && !bookmarks.some(({ point }) => point);
  element("cut").hidden = ndc;
  overlay.show(measurements, bookmarks, (bookmark) => { if (!controls.dragged) visit(bookmark); });
  setMode(scene.shaders.modes[settings.mode] ? settings.mode : "normal");
  status("");
}

// Flies to a bookmark, and shows what it says.
function visit(bookmark) {
  setPlaying(false);
  camera.go(bookmark, bookmark.fov);
  element("note").hidden = !bookmark.text;
  element("note-title").textContent = bookmark.name;
  element("note-text").textContent = bookmark.text;
  touch();
}

function status(words) {
  const voxels = `${scene.gridSize.join(" × ")} voxels`;
  element("facts").textContent = words ? `${voxels} · ${words}` : voxels;
}

function fit() {
  const density = Math.min(window.devicePixelRatio || 1, SHARPEST);
  canvas.width = Math.max(1, Math.round(canvas.clientWidth * density));
  canvas.height = Math.max(1, Math.round(canvas.clientHeight * density));
  camera.shape(canvas.width / canvas.height);
  touch();
}

// Shows the levels of a scene, the coarsest first; stays at one where the next fails.
async function load(found) {
  const first = !scene;
  scene = found;
  if (first) {
    camera = new Camera(scene.camera);
    controls = new Controls(canvas, element("overlay"), camera, () => {
      if (controls.busy) setPlaying(false);
      touch();
    }, commands);
    buildInterface();
  } else camera.follow(scene.camera);
  describe();
  await showLevels().finally(() => scene.worker.terminate());
}

async function showLevels() {
  const { length } = scene.levels;
  for (let index = 0; index < length; index++) {
    const coarser = `Shown at ${SHARES[scene.levels[Math.max(index - 1, 0)].halvings] ?? "a fraction of its"} resolution.`;
    try {
      if (index && location.hash === COARSE) throw new Error("The graphics driver could not hold more.");
      await show(index, coarser);
    } catch (error) {
      if (!index) throw error;
      if (gl.isContextLost()) await new Promise(() => {}); // the page is about to be loaded again
      status(`${coarser} ${error.message}`);
      return;
    }
    status("");
  }
}

async function show(index, coarser) {
  const next = new Renderer(gl, scene.levels[index]);
  const report = (share) => {
    element("progress").value = share;
    if (index) status(`${coarser} ${Math.round(100 * share)} % of the rest is here.`);
  };
  element("notice-text").textContent = "Loading…";
  report(0);
  try {
    await unpack(scene, index, next, report);
    next.check();
  } catch (error) {
    next.release();
    throw error;
  }
  renderer?.release();
  renderer = next;
  touch();
  if (element("notice").className === "done") return;
  new ResizeObserver(fit).observe(canvas);
  fit();
  element("bar").hidden = false;
  open(null);
  element("notice").className = "done";
}

// Shows what the server has newer, as long as it says that there will be more.
async function follow() {
  let [tag, shown] = ["", element("scene").textContent];
  while (scene.live) {
    await new Promise((resolve) => setTimeout(resolve, ASK_MS));
    try {
      const answer = await fetch(location.pathname, { headers: { "If-None-Match": tag } });
      if (answer.status !== 200) continue;
      const bytes = new Uint8Array(await answer.arrayBuffer());
      // A preview is one file in UTF-16; the finished pack has files, index.html in UTF-8.
      const html = new TextDecoder(bytes[0] === 0xff ? "utf-16" : "utf-8").decode(bytes);
      const page = new DOMParser().parseFromString(html, "text/html");
      const text = page.getElementById("scene").textContent;
      if (text !== shown) await load(sceneOf(await read(page), page));
      shown = text;
      tag = answer.headers.get("ETag");
    } catch (error) {
      status(error.message); // the next answer may be better
    }
  }
}

// Shows the scene of a description.
async function start(description) {
  element("notice-title").textContent = document.title;
  gl = canvas.getContext("webgl2", { alpha: false, antialias: false, depth: false, powerPreference: "high-performance" });
  if (!gl) throw new Error("This browser has no WebGL 2. Try a current Chrome, Edge, Firefox or Safari, with hardware acceleration.");
  let loading = true;
  canvas.addEventListener("webglcontextlost", () => {
    if (!loading || !renderer) return fail("The graphics driver restarted. Load the page again.");
    location.hash = COARSE; // it had the coarse level, and broke under the next
    location.reload();
  });
  await load(sceneOf(description));
  loading = false;
  follow();
}

// For loader.js, for pages around this one, and for tests: the camera, and pictures of any view.
globalThis.snerg = {
  ...globalThis.snerg,
  start,
  get camera() { return camera; },
  get scene() { return scene; },
  get level() { return renderer?.scene; },
  get resting() { return !frame; },
  picture: (view, wanted, width, height) => renderer.picture(view, { ...settings, ...wanted }, width, height),
};
