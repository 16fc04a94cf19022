// Geoms as triangles: {position, normal: three numbers a corner}, in the frame of the geom.

const SIDES = 18; // of a round thing

function fromFaces(vertices, faces) { // flat faces, each with its own normal
  const position = [], normal = [];
  for (const face of faces) {
    const [a, b, c] = face.map((i) => vertices[i]);
    const n = unit(cross(minus(b, a), minus(c, a)));
    position.push(...a, ...b, ...c);
    normal.push(...n, ...n, ...n);
  }
  return { position, normal };
}

// A profile of [radius, z, the normal's radial part, its z] turned about z.
function turnedProfile(profile) {
  const position = [], normal = [];
  const corner = ([radius, z, nr, nz], i) => {
    const angle = (2 * Math.PI * i) / SIDES, cos = Math.cos(angle), sin = Math.sin(angle);
    position.push(radius * cos, radius * sin, z);
    normal.push(nr * cos, nr * sin, nz);
  };
  for (let p = 0; p + 1 < profile.length; p += 1) {
    const low = profile[p], high = profile[p + 1];
    for (let i = 0; i < SIDES; i++) {
      corner(low, i), corner(low, i + 1), corner(high, i + 1);
      corner(low, i), corner(high, i + 1), corner(high, i);
    }
  }
  return { position, normal };
}

function cylinder(radius, low, high) {
  return turnedProfile([
    [0, low, 0, -1], [radius, low, 0, -1], [radius, low, 1, 0], [radius, high, 1, 0], [radius, high, 0, 1],
    [0, high, 0, 1],
  ]);
}

function cone(radius, length) {
  const slope = Math.hypot(radius, length), nr = length / slope, nz = radius / slope;
  return turnedProfile([[0, 0, 0, -1], [radius, 0, 0, -1], [radius, 0, nr, nz], [0, length, nr, nz]]);
}

function capsule(radius, half) { // a sphere where half is 0
  const profile = [];
  for (const side of [-1, 1])
    for (let i = 0; i <= 6; i++) {
      const angle = (Math.PI / 12) * (side < 0 ? i - 6 : i);
      const cos = Math.cos(angle), sin = Math.sin(angle);
      profile.push([radius * cos, radius * sin + side * half, cos, sin]);
    }
  return turnedProfile(profile);
}

function box([x, y, z]) {
  const corners = [0, 1, 2, 3, 4, 5, 6, 7].map((i) => [i & 1 ? x : -x, i & 2 ? y : -y, i & 4 ? z : -z]);
  const sides = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
  return fromFaces(corners, sides.flatMap(([a, b, c, d]) => [[a, b, c], [a, c, d]]));
}

function field({ x, y, heights }) { // cells are split as MuJoCo splits them
  const height = numbers(heights), vertices = [], faces = [];
  y.forEach((b, j) => x.forEach((a, i) => vertices.push([a, b, height(j * x.length + i, 0)])));
  for (let j = 0; j + 1 < y.length; j++)
    for (let i = 0; i + 1 < x.length; i++) {
      const near = j * x.length + i, far = near + x.length + 1;
      faces.push([near, near + 1, far], [near, far, far - 1]);
    }
  return fromFaces(vertices, faces);
}

// Boxes of the ground reach into the track, which is drawn behind everything: they begin on it.
function overTrack(geom) {
  if (geom.shape !== "box" || geom.position[2] > geom.size[2]) return geom;
  const half = (geom.position[2] + geom.size[2]) / 2, with_z = ([x, y]) => [x, y, half];
  return { ...geom, size: with_z(geom.size), position: with_z(geom.position) };
}

function triangles(geom, meshes) {
  switch (geom.shape) {
    case "field": return field(geom.field);
    case "mesh": return fromFaces(meshes[geom.mesh].vertices, meshes[geom.mesh].faces);
    case "cylinder": return cylinder(geom.size[0], -geom.size[1], geom.size[1]);
    case "capsule": return capsule(geom.size[0], geom.size[1]);
    case "sphere": return capsule(geom.size[0], 0);
    default: return box(geom.size);
  }
}
