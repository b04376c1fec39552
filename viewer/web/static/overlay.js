// Measurements over the picture: their points, the lines between them, and what they measure.
import { dot, mix, radians, subtract } from "./vectors.js";

const LABEL = [10, -8]; // pixels from the point that it belongs to

export class Overlay {
  constructor(svg) {
    this.svg = svg;
    this.shapes = [];
  }

  // measurements: [{ points, text }], points in the grid frame.
  show(measurements) {
    this.svg.replaceChildren();
    this.shapes = measurements.map(({ points, text }) => {
      const line = this.element("polyline");
      const circles = points.map(() => this.element("circle"));
      const label = this.element("text");
      label.textContent = text;
      for (const circle of circles) circle.setAttribute("r", "4.5");
      return { points, line, circles, label };
    });
  }

  element(name) {
    return this.svg.appendChild(document.createElementNS(this.svg.namespaceURI, name));
  }

  // Moves everything to where a view sees it; what lies behind the camera is hidden.
  draw(view) {
    const [width, height] = [this.svg.clientWidth, this.svg.clientHeight];
    const focal = (0.5 * height) / Math.tan(0.5 * radians(view.fov));
    const seen = (point) => {
      const [x, y, z] = view.axes.map((axis) => dot(axis, subtract(point, view.eye)));
      return z < -1e-6 ? [0.5 * width - (focal * x) / z, 0.5 * height + (focal * y) / z] : null;
    };
    for (const { points, line, circles, label } of this.shapes) {
      const places = points.map(seen);
      line.setAttribute("points", places.every(Boolean) ? places.join(" ") : "");
      for (const [i, circle] of circles.entries()) put(circle, "c", places[i]);
      const middle = (points.length - 1) / 2;
      const at = seen(mix(points[Math.floor(middle)], points[Math.ceil(middle)], 0.5));
      put(label, "", at?.map((v, i) => v + LABEL[i]));
    }
  }
}

function put(element, prefix, place) {
  element.style.display = place ? "" : "none";
  if (place) for (const i of [0, 1]) element.setAttribute(prefix + "xy"[i], String(place[i]));
}
