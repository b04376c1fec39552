// The camera: a turntable that orbits, pans, zooms and flies, with damping. It moves as the desktop's does
// (viewer/features/camera), with the same constants.
//
// A pose is { pivot, azimuth, elevation, distance }: the point looked at, and where the camera stands as seen from there (degrees,
// grid units). `axes` are right, up and front of the turntable. `goal` is where the user wants the camera, `shown` follows it; `held`
// is an exact view that is shown instead until the user moves. Distances of the mouse are in heights of the picture, y down.
import { add, clamp, degrees, dot, mix, norm, radians, rotate, scaled, subtract } from "./vectors.js";

const TURN_PER_HEIGHT = 200; // degrees for a drag over the picture's whole height
const DOLLY_STEP = 0.9; // of the distance, per notch of the wheel
const SETTLE_S = 0.07; // time constant of the damping
const MARGINS = [1.05, 1.22]; // of half the picture, across and upright, over what is seen: buttons lie below
const FASTER = 1.2;
// Of forward-facing scenes, which look right from about where they were photographed only.
const [AHEAD, DISTANCES, PAN_LIMIT, TURN_LIMIT, PAN_PER_HEIGHT, START_DISTANCE] = [180, [0.05, 0.3], 0.4, 20, 1.2, 0.25];

const shortestTurn = (from, to) => ((((to - from + 180) % 360) + 360) % 360) - 180;

export class Camera {
  constructor(description) {
    this.description = description;
    const { home, fov, bounded, radius } = description;
    this.axes = home.axes;
    this.home = this.goal = this.shown = poseOf(home);
    this.fov = fov;
    this.bounded = bounded;
    this.speed = bounded ? 0.1 : 0.5 * radius; // grid units a second
    this.limits = bounded ? DISTANCES : [1e-3 * radius, 20 * radius];
    this.held = null;
    this.anchorEye = false; // what the damping keeps straight: the eye's way (flying) or the pivot's
  }

  // [right, up, back] of a level camera
  rotation({ azimuth, elevation }) {
    const [ca, sa] = [Math.cos(radians(azimuth)), Math.sin(radians(azimuth))];
    const [ce, se] = [Math.cos(radians(elevation)), Math.sin(radians(elevation))];
    const turned = [[ca, 0, -sa], [-sa * se, ce, -ca * se], [sa * ce, se, ca * ce]];
    const [right, up, back] = turned.map((column) => rotate(this.axes, column));
    return [this.description.mirrored ? scaled(right, -1) : right, up, back];
  }

  eye(pose) {
    return add(pose.pivot, scaled(this.rotation(pose)[2], pose.distance));
  }

  seenFrom(pose, eye) {
    return { ...pose, pivot: subtract(eye, scaled(this.rotation(pose)[2], pose.distance)) };
  }

  // What the renderer draws.
  view(near) {
    if (this.held) return { ...this.held, near };
    return { axes: this.rotation(this.shown), eye: this.eye(this.shown), fov: this.fov, near };
  }

  // The scene has been replaced by a newer one; the camera stays where it is.
  follow(description) {
    this.description = description;
    this.home = poseOf(description.home);
  }

  // The picture has another shape, width over height. A first view that was not left shows all of the scene.
  shape(aspect) {
    if (!this.description.framed) return;
    const before = this.home;
    this.home = { ...before, distance: this.framingDistance(before, aspect) };
    if (this.goal === before) this.goal = this.shown = this.home;
  }

  framingDistance(pose, aspect) {
    const [right, up, back] = this.rotation(pose);
    const half = Math.tan(radians(this.description.fov) / 2);
    const distances = this.description.outline.map((point) => {
      const local = subtract(point, this.description.middle);
      const across = (MARGINS[0] * Math.abs(dot(local, right))) / (half * aspect);
      return Math.max(across, (MARGINS[1] * Math.abs(dot(local, up))) / half) + dot(local, back);
    });
    return Math.max(...distances, 1e-6);
  }

  // Lets `shown` follow `goal`; true while it has not arrived.
  update(seconds) {
    if (this.shown === this.goal) return false;
    const { shown, goal } = this;
    const share = 1 - Math.exp(-seconds / SETTLE_S);
    let pose = {
      pivot: mix(shown.pivot, goal.pivot, share),
      azimuth: shown.azimuth + share * shortestTurn(shown.azimuth, goal.azimuth),
      elevation: shown.elevation + share * (goal.elevation - shown.elevation),
      distance: shown.distance * (goal.distance / shown.distance) ** share,
    };
    if (this.anchorEye) pose = this.seenFrom(pose, mix(this.eye(shown), this.eye(goal), share));
    const off = norm(subtract(this.eye(pose), this.eye(goal))) / goal.distance;
    const turn = Math.max(Math.abs(shortestTurn(pose.azimuth, goal.azimuth)), Math.abs(pose.elevation - goal.elevation));
    this.shown = off < 2e-4 && turn < 0.02 ? goal : pose;
    return true;
  }

  // Gestures

  // Leaves a held view, from exactly there, but level.
  takeOver() {
    if (!this.held) return;
    const { axes, eye, fov } = this.held;
    const [right, up, front] = this.axes;
    const back = axes[2];
    const elevation = degrees(Math.asin(clamp(dot(back, up), -1, 1)));
    const away = Math.max(dot(subtract(this.description.middle, eye), scaled(back, -1)), 0.2 * this.description.radius);
    const pose = { azimuth: degrees(Math.atan2(dot(back, right), dot(back, front))), elevation, distance: away };
    this.held = null;
    this.fov = fov;
    this.goal = this.shown = this.kept(this.seenFrom({ ...pose, pivot: [0, 0, 0] }, eye));
  }

  // Turns about the pivot, or where the camera stands: flying.
  orbit(dx, dy, flying = false) {
    this.takeOver();
    const sign = this.description.mirrored ? 1 : -1;
    const gain = this.bounded ? 0.3 : flying ? 0.6 : 1;
    const along = this.bounded ? dx : sign * dx;
    const elevation = clamp(this.goal.elevation + TURN_PER_HEIGHT * gain * dy, -90, 90);
    const turned = { ...this.goal, azimuth: this.goal.azimuth + TURN_PER_HEIGHT * gain * along, elevation };
    this.anchorEye = flying && !this.bounded;
    this.goal = this.kept(this.anchorEye ? this.seenFrom(turned, this.eye(this.goal)) : turned);
  }

  // Slides parallel to the picture, so that what lies at the pivot's depth stays under the cursor.
  pan(dx, dy) {
    this.takeOver();
    this.anchorEye = false;
    const half = Math.tan(radians(this.fov) / 2);
    const ahead = { azimuth: AHEAD, elevation: 0 };
    const [right, up] = this.rotation(this.bounded ? ahead : this.goal);
    const share = this.goal.distance / START_DISTANCE;
    this.shift(this.bounded ? PAN_PER_HEIGHT * half * share : 2 * this.goal.distance * half, right, up, -dx, dy);
  }

  shift(length, right, up, x, y) {
    const by = add(scaled(right, length * x), scaled(up, length * y));
    this.goal = this.kept({ ...this.goal, pivot: add(this.goal.pivot, by) });
  }

  // Moves towards (notches > 0) what lies under the cursor (-1 … 1, y up, x times the aspect) at the pivot's depth, or away.
  dolly(notches, [x, y] = [0, 0]) {
    this.takeOver();
    this.anchorEye = false;
    const distance = clamp(this.goal.distance * DOLLY_STEP ** notches, ...this.limits);
    const [right, up] = this.rotation(this.goal);
    const length = (this.goal.distance - distance) * Math.tan(radians(this.fov) / 2);
    this.goal = { ...this.goal, distance };
    this.shift(length, right, up, x, y);
  }

  // Moves for some time; -1 … 1 along the camera's axes.
  fly(right, up, forward, seconds) {
    this.takeOver();
    this.anchorEye = true;
    const by = rotate(this.rotation(this.goal), [right, up, -forward]);
    this.goal = this.kept({ ...this.goal, pivot: add(this.goal.pivot, scaled(by, this.speed * seconds)) });
  }

  faster(notches) {
    const { radius } = this.description;
    this.speed = clamp(this.speed * FASTER ** notches, 1e-3 * radius, 10 * radius);
  }

  // A pose within what the scene allows.
  kept(pose) {
    if (!this.bounded) return pose;
    const [x, y] = pose.pivot.map((v) => clamp(v, -PAN_LIMIT, PAN_LIMIT));
    const azimuth = AHEAD + clamp(shortestTurn(AHEAD, pose.azimuth), -TURN_LIMIT, TURN_LIMIT);
    const elevation = clamp(pose.elevation, -TURN_LIMIT, TURN_LIMIT);
    return { pivot: [x, y, 0], azimuth, elevation, distance: clamp(pose.distance, ...DISTANCES) };
  }

  // Commands

  // Flies to a view of the page's description: the first one, or a bookmark.
  go(view, fov) {
    this.takeOver();
    if (String(view.axes) !== String(this.axes)) {
      this.axes = view.axes;
      this.shown = poseOf(view);
    }
    this.anchorEye = false;
    this.fov = fov;
    this.goal = this.kept(poseOf(view));
  }

  reset() {
    const { home, fov } = this.description;
    this.go(home, fov);
    this.goal = this.home;
  }
}

function poseOf({ pivot, azimuth, elevation, distance }) {
  return { pivot, azimuth, elevation, distance };
}
