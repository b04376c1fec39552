// Mouse, touch and keys. Everything that moves the camera calls `moved`; keys that are commands call `commands[name]()`.

const NOTCH = 100; // pixels that browsers scroll for a notch of the wheel
const LINES = 3; // a notch in lines
const CLICK = 4; // pixels that a click may move
const TURN = 15; // degrees for an arrow key
const AXES = { w: [0, 0, 1], s: [0, 0, -1], a: [-1, 0, 0], d: [1, 0, 0], e: [0, 1, 0], q: [0, -1, 0] };
const COMMANDS = {
  r: "reset", home: "reset", f: "fullscreen", b: "background", " ": "play", p: "save", h: "hide", "?": "help", escape: "close",
};

export class Controls {
  // overlay: lies over the canvas; its parts that can be clicked take drags and the wheel as the canvas does.
  constructor(canvas, overlay, camera, moved, commands) {
    this.canvas = canvas;
    this.camera = camera;
    this.moved = moved;
    this.commands = commands;
    this.pointers = new Map(); // by id: { x, y } in pixels of the page
    this.travelled = 0; // pixels since a pointer went down, to tell a click from a drag
    this.keys = new Set();
    const listen = (target, name, action) => target.addEventListener(name, action.bind(this), { passive: false });
    for (const target of [canvas, overlay]) {
      listen(target, "pointerdown", this.down);
      listen(target, "pointermove", this.move);
      for (const name of ["pointerup", "pointercancel"]) listen(target, name, this.up);
      listen(target, "wheel", this.wheel);
      listen(target, "contextmenu", (event) => event.preventDefault());
    }
    listen(window, "keydown", this.keyDown);
    listen(window, "keyup", (event) => this.keys.delete(event.key.toLowerCase()));
    listen(window, "blur", () => this.keys.clear());
  }

  // Whether the pointer moved too far for a click since it went down.
  get dragged() {
    return this.travelled >= CLICK;
  }

  // Whether the camera is in somebody's hands.
  get busy() {
    return this.pointers.size > 0 || this.keys.size > 0;
  }

  // Flies for some time with the keys that are held.
  update(seconds) {
    if (!this.keys.size) return;
    const sum = [0, 0, 0];
    for (const key of this.keys) for (const i of [0, 1, 2]) sum[i] += AXES[key][i];
    this.camera.fly(...sum, seconds);
  }

  down(event) {
    this.canvas.focus({ preventScroll: true });
    event.target.setPointerCapture(event.pointerId);
    if (!this.pointers.size) this.travelled = 0;
    this.pointers.set(event.pointerId, { x: event.clientX, y: event.clientY });
    this.pans = event.button !== 0 || event.shiftKey || event.ctrlKey;
    event.preventDefault();
    this.moved();
  }

  up(event) {
    this.pointers.delete(event.pointerId);
    this.moved();
  }

  move(event) {
    const before = this.pointers.get(event.pointerId);
    if (!before) return;
    const height = this.canvas.clientHeight;
    const [dx, dy] = [(event.clientX - before.x) / height, (event.clientY - before.y) / height];
    this.travelled += (Math.abs(dx) + Math.abs(dy)) * height;
    if (this.pointers.size === 1) {
      // Forward-facing scenes slide with the left button, as there is only one side to look from.
      if (this.pans !== this.camera.bounded) this.camera.pan(dx, dy);
      else this.camera.orbit(dx, dy, this.keys.size > 0);
    } else this.pinch(event, before, dx, dy);
    this.pointers.set(event.pointerId, { x: event.clientX, y: event.clientY });
    this.moved();
  }

  // One of two fingers moves: half of its way pans, and the fingers' distance zooms.
  pinch(event, before, dx, dy) {
    const other = [...this.pointers].find(([id]) => id !== event.pointerId)[1];
    const apart = ({ x, y }) => Math.max(Math.hypot(x - other.x, y - other.y), 1);
    const after = { x: event.clientX, y: event.clientY };
    const notches = Math.log(apart(before) / apart(after)) / Math.log(0.9);
    this.camera.pan(dx / 2, dy / 2);
    this.camera.dolly(notches, this.cursor({ x: (after.x + other.x) / 2, y: (after.y + other.y) / 2 }));
  }

  // A point of the page as the camera has it: -1 … 1, y up, x times the aspect.
  cursor({ x, y }) {
    const box = this.canvas.getBoundingClientRect();
    return [(2 * (x - box.left) - box.width) / box.height, 1 - (2 * (y - box.top)) / box.height];
  }

  wheel(event) {
    event.preventDefault();
    const unit = event.deltaMode === WheelEvent.DOM_DELTA_PIXEL ? NOTCH : LINES;
    const notches = Math.min(Math.max(-event.deltaY / unit, -4), 4);
    if (this.keys.size) this.camera.faster(notches);
    else this.camera.dolly(notches, this.cursor({ x: event.clientX, y: event.clientY }));
    this.moved();
  }

  keyDown(event) {
    const key = event.key.toLowerCase();
    const own = { INPUT: /^( |home|arrow.*)$/, BUTTON: /^ $/ }[event.target.tagName]; // keys that work the focused element
    if (event.ctrlKey || event.metaKey || event.altKey || own?.test(key)) return;
    const turns = { arrowleft: [-TURN, 0], arrowright: [TURN, 0], arrowup: [0, TURN], arrowdown: [0, -TURN] }[key];
    if (AXES[key]) this.keys.add(key);
    else if (turns) this.camera.orbit(...turns.map((v) => v / 200));
    else if (key === "+" || key === "=") this.camera.dolly(1);
    else if (key === "-") this.camera.dolly(-1);
    else if (/^[1-9]$/.test(key)) this.commands.mode(Number(key) - 1);
    else if (COMMANDS[key]) this.commands[COMMANDS[key]]();
    else return;
    event.preventDefault();
    this.moved();
  }
}
