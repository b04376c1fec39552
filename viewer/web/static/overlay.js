// Over the picture: measurements (their points, the lines between them, and what they measure), and numbers of annotated places.
import { dot, mix, radians, subtract } from "./vectors.js";

const LABEL = [10, -8]; // pixels from the point that it belongs to

export class Overlay {
  constructor(svg) {
    this.svg = svg;
    this.shapes = [];
    this.places = [];
  }

  // measurements: [{ points, text }], points in the grid frame. bookmarks: those with a `point` are places; `visit` takes one of them.
  show(measurements, bookmarks, visit) {
    this.svg.replaceChildren();
    this.shapes = measurements.map(({ points, text }) => {
      const line = this.element("polyline");
      const circles = points.map(() => this.element("circle"));
      const label = this.element("text");
      label.textContent = text;
      for (const circle of circles) circle.setAttribute("r", "4.5");
      return { points, line, circles, label };
    });
    this.places = bookmarks.flatMap((bookmark, i) => (bookmark.point ? [this.place(bookmark, i + 1, visit)] : []));
  }

  place(bookmark, number, visit) {
    const group = this.element("g");
    const [circle, label] = ["circle", "text"].map((name) => group.appendChild(this.element(name)));
    group.setAttribute("class", "place");
    circle.setAttribute("r", "12");
    label.textContent = String(number);
    group.addEventListener("click", () => visit(bookmark));
    return { point: bookmark.point, group, covered: false };
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
    for (const { point, group, covered } of this.places) {
      const at = covered ? null : seen(point);
      group.style.display = at ? "" : "none";
      if (at) group.setAttribute("transform", `translate(${at})`);
    }
  }
}

function put(element, prefix, place) {
  element.style.display = place ? "" : "none";
  if (place) for (const i of [0, 1]) element.setAttribute(prefix + "xy"[i], String(place[i]));
}
