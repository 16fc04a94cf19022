// Quaternions are w-x-y-z, matrices 4 x 4 by columns, as WebGL takes them.

function rotation([w, x, y, z]) {
  return [
    1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y), 0,
    2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x), 0,
    2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y), 0,
    0, 0, 0, 1,
  ];
}

function pose(position, quaternion) {
  const matrix = rotation(quaternion);
  [matrix[12], matrix[13], matrix[14]] = position;
  return matrix;
}

function about(axis, angle) {
  const s = Math.sin(angle / 2);
  return [Math.cos(angle / 2), s * axis[0], s * axis[1], s * axis[2]];
}

function product(a, b) {
  const c = new Array(16);
  for (let column = 0; column < 4; column++)
    for (let row = 0; row < 4; row++) {
      let sum = 0;
      for (let k = 0; k < 4; k++) sum += a[4 * k + row] * b[4 * column + k];
      c[4 * column + row] = sum;
    }
  return c;
}

function moved(m, [x, y, z]) {
  return [0, 1, 2].map((row) => m[row] * x + m[4 + row] * y + m[8 + row] * z + m[12 + row]);
}

function turned(m, [x, y, z]) {
  return [0, 1, 2].map((row) => m[row] * x + m[4 + row] * y + m[8 + row] * z);
}

const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const minus = (a, b) => a.map((value, i) => value - b[i]);
const dot = (a, b) => a.reduce((sum, value, i) => sum + value * b[i], 0);

function unit(a) {
  const length = Math.hypot(...a);
  return length > 0 ? a.map((value) => value / length) : a;
}

// From the world to the view of a camera at `eye` that looks along `ahead`, its picture's top towards the sky.
function view(eye, ahead) {
  const back = ahead.map((value) => -value), right = unit(cross([0, 0, 1], back)), up = cross(back, right);
  const rows = [right, up, back];
  const matrix = [];
  for (let column = 0; column < 3; column++) matrix.push(...rows.map((row) => row[column]), 0);
  return [...matrix, ...rows.map((row) => -dot(row, eye)), 1];
}

// `tall` and `wide` are the tangents of half the field of view.
function perspective(tall, wide, near, far) {
  const depth = 1 / (near - far);
  return [1 / wide, 0, 0, 0, 0, 1 / tall, 0, 0, 0, 0, (near + far) * depth, -1, 0, 0, 2 * near * far * depth, 0];
}

// The matrix of an arrow's part: its z axis along `direction`, `length` long, from `start`.
function along(start, direction, length) {
  const z = unit(direction), x = unit(cross(Math.abs(z[2]) < 0.9 ? [0, 0, 1] : [1, 0, 0], z)), y = cross(z, x);
  return [...x, 0, ...y, 0, ...z.map((value) => value * length), 0, ...start, 1];
}
