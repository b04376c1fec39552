// How many pixels to draw: few enough while something moves to hold a frame rate, all of them once it rests. Then the picture is
// drawn in tiles, some each frame, so that the page answers on slow devices, too.

const TARGET_MS = 1000 / 30;
const SHARE = 0.75; // of a frame is planned for drawing
const SMALLEST_SCALE = 0.15; // of the sides
const STEP = 1.25; // the most that the scale changes from frame to frame
const SMALLEST_TILE = 64; // pixels a side

export class Resolution {
  constructor() {
    this.scale = 0.5;
    this.pixelsPerMs = 0; // 0: not known yet
  }

  // So many pixels took so long to draw.
  measured(pixels, milliseconds, moving) {
    const speed = pixels / Math.max(milliseconds, 0.1);
    this.pixelsPerMs = this.pixelsPerMs ? 0.6 * this.pixelsPerMs + 0.4 * speed : speed;
    if (!moving) return;
    const factor = Math.sqrt((SHARE * TARGET_MS) / Math.max(milliseconds, 0.1));
    if (Math.abs(factor - 1) < 0.05) return;
    this.scale = Math.min(Math.max(this.scale * Math.min(Math.max(factor, 1 / STEP), STEP), SMALLEST_SCALE), 1);
  }

  // Size of the picture while something moves.
  size(width, height) {
    return [Math.max(1, Math.round(this.scale * width)), Math.max(1, Math.round(this.scale * height))];
  }

  // Boxes [x, y, w, h] that cover the picture, from the middle outwards, each of about half a frame's time.
  tiles(width, height) {
    const pixels = 0.5 * TARGET_MS * (this.pixelsPerMs || SMALLEST_TILE ** 2 / TARGET_MS);
    const side = Math.max(Math.sqrt(pixels), SMALLEST_TILE);
    const cuts = (length) => {
      const count = Math.ceil(length / side);
      return Array.from({ length: count + 1 }, (_, i) => Math.round((length * i) / count));
    };
    const [xs, ys] = [cuts(width), cuts(height)];
    const boxes = [];
    for (let j = 1; j < ys.length; j++)
      for (let i = 1; i < xs.length; i++) boxes.push([xs[i - 1], ys[j - 1], xs[i] - xs[i - 1], ys[j] - ys[j - 1]]);
    const away = ([x, y, w, h]) => (x + w / 2 - width / 2) ** 2 + (y + h / 2 - height / 2) ** 2;
    return boxes.sort((a, b) => away(a) - away(b));
  }
}
