// Vectors of three numbers; a rotation is the list of its columns: a camera's right, up and back axes.

export const add = (a, b) => a.map((v, i) => v + b[i]);
export const subtract = (a, b) => a.map((v, i) => v - b[i]);
export const scaled = (a, s) => a.map((v) => v * s);
export const dot = (a, b) => a.reduce((sum, v, i) => sum + v * b[i], 0);
export const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
export const norm = (a) => Math.hypot(...a);
export const mix = (a, b, t) => a.map((v, i) => v + t * (b[i] - v));
export const clamp = (v, low, high) => Math.min(Math.max(v, low), high);
export const radians = (degrees) => (degrees * Math.PI) / 180;
export const degrees = (angle) => (angle * 180) / Math.PI;

// columns times a vector
export const rotate = (columns, v) => columns[0].map((_, i) => columns.reduce((sum, c, j) => sum + c[i] * v[j], 0));

// The upper left 3 x 3 of a row-major matrix times a vector.
export const transform = (rows, v) => [0, 1, 2].map((i) => rows[i][0] * v[0] + rows[i][1] * v[1] + rows[i][2] * v[2]);
