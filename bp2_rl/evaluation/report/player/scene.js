// What is on the canvas: the track, ground that is not flat, the robot's shadow, the robot, and the forces under its
// feet. The world's origin is on the track under the trunk, and the track moves.

const ROBOT_SHADER = `#version 300 es
in vec3 position; in vec3 normal; in vec3 color; in float part;
uniform mat4 camera; uniform mat4 projection; uniform mat4 parts[PARTS]; uniform vec3 sun; uniform bool flat_on_ground;
uniform float level;
out vec3 at; out vec3 facing; out vec3 paint;
void main() {
  mat4 pose = parts[int(part)];
  vec4 place = pose * vec4(position, 1.0);
  if (flat_on_ground) place.xyz -= sun * (max(place.z - level, 0.0) / sun.z);
  at = place.xyz; facing = mat3(pose) * normal; paint = color;
  gl_Position = projection * camera * place;
}`;
const FOG = `#version 300 es
precision highp float;
const vec3 HAZE = vec3(0.9, 0.94, 0.97);
float fog(vec2 p) { return 1.0 - exp(-pow(length(p) / 32.0, 2.0)); }
`;
const ROBOT_PAINT = `${FOG}
in vec3 at; in vec3 facing; in vec3 paint;
uniform vec3 eye; uniform vec3 sun; uniform bool flat_on_ground; uniform bool glows;
out vec4 color;
void main() {
  if (flat_on_ground) { color = vec4(0.07, 0.02, 0.02, 0.5 * smoothstep(5.0, 2.0, length(at.xy))); return; }
  vec3 n = normalize(facing), light = normalize(sun), toward = normalize(eye - at), base = pow(paint, vec3(2.2));
  if (dot(n, toward) < 0.0) n = -n;
  vec3 sky = mix(vec3(0.36, 0.22, 0.18), vec3(0.75, 0.83, 0.95), 0.5 + 0.5 * n.z);
  float shine = pow(max(dot(n, normalize(light + toward)), 0.0), 40.0);
  float rim = pow(1.0 - max(dot(n, toward), 0.0), 4.0);
  vec3 lit = base * (0.55 * sky + 0.85 * max(dot(n, light), 0.0)) + 0.18 * shine + 0.06 * rim * sky;
  if (glows) lit = base * (0.75 + 0.35 * max(dot(n, light), 0.0));
  color = vec4(mix(pow(lit, vec3(1.0 / 2.2)), HAZE, fog(at.xy)), 1.0);
}`;
const TRACK_SHADER = `#version 300 es
in vec2 corner;
uniform mat4 camera; uniform vec2 tangent;
out vec3 ray;
void main() {
  ray = transpose(mat3(camera)) * vec3(corner * tangent, -1.0);
  gl_Position = vec4(corner, 0.0, 1.0);
}`;
// Lanes of 1.22 m, a mark at every metre and a line at every ten, as in the MuJoCo scene; beside them mown grass.
const TRACK_PAINT = `${FOG}
in vec3 ray;
uniform vec3 eye; uniform vec2 origin;
out vec4 color;
float grain(vec2 p) { return fract(sin(dot(mod(floor(p), 289.0), vec2(12.9898, 78.233))) * 43758.5453); }
float stripe(float x, float period, float half_width, float blur) {
  float far = abs(x - period * round(x / period)), covered = clamp(2.0 * half_width / (2.0 * blur + 1e-4), 0.0, 1.0);
  return smoothstep(half_width + blur, max(half_width - blur, 0.0), far) * max(covered, smoothstep(0.3, 0.0, blur));
}
void main() {
  float down = min(ray.z, -1e-4);
  vec2 p = eye.xy - ray.xy * (eye.z / down), blur = max(fwidth(p), vec2(1e-4));
  vec2 at = p + origin;
  float lanes = stripe(at.y - 0.61, 1.22, 0.025, blur.y);
  float marks = stripe(at.x, 1.0, 0.0125, blur.x) * smoothstep(0.1 + blur.y, 0.1 - blur.y, abs(at.y + 0.735));
  float tens = stripe(at.x, 10.0, 0.025, blur.x) * step(abs(at.y), 3.075);
  lanes *= step(abs(at.y), 3.075 + blur.y);
  float fine = smoothstep(0.02, 0.0, max(blur.x, blur.y)), rough = grain(at * 90.0) - 0.5;
  vec3 track = vec3(0.57, 0.25, 0.2) * (1.0 + 0.16 * fine * rough);
  track = mix(track, vec3(0.93, 0.93, 0.9), max(lanes, max(marks, tens)));
  vec3 grass = mix(vec3(0.36, 0.5, 0.24), vec3(0.42, 0.56, 0.28), smoothstep(-blur.x, blur.x, abs(mod(at.x, 10.0) - 5.0) - 2.5));
  grass *= 1.0 + 0.25 * fine * rough;
  track = mix(track, grass, smoothstep(-blur.y, blur.y, abs(at.y) - 3.6));
  vec3 sky = mix(HAZE, vec3(0.45, 0.62, 0.82), smoothstep(0.0, 0.6, normalize(ray).z));
  color = vec4(ray.z < 0.0 ? mix(track, HAZE, fog(p)) : sky, 1.0);
}`;

const SUN = [-0.3, -0.45, 1];
const NEWTONS_A_METRE = 1500, LEAST_FORCE = 20, HEAD = 0.07; // N/m of an arrow; N below which there is none; m
const FIELD = Math.tan((20 * Math.PI) / 180); // tangent of half the field of view

class Scene {
  constructor(canvas, content) {
    const gl = (this.gl = canvas.getContext("webgl2", { antialias: true, stencil: true }));
    if (!gl) throw new Error("no WebGL 2");
    this.canvas = canvas;
    this.content = content;
    this.parts = content.links.length + 2 * content.feet.length + 1;
    this.robot = this.program(ROBOT_SHADER.replace("PARTS", this.parts), ROBOT_PAINT);
    this.track = this.program(TRACK_SHADER, TRACK_PAINT);
    this.load(...this.build());
    this.screen = this.vertices(this.track, { corner: [2, new Float32Array([-1, -1, 3, -1, -1, 3])] });
  }

  program(vertex, fragment) {
    const gl = this.gl, program = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS) && !gl.isContextLost())
      throw new Error(gl.getProgramInfoLog(program));
    return program;
  }

  vertices(program, attributes) {
    const gl = this.gl, array = gl.createVertexArray();
    gl.bindVertexArray(array);
    for (const [name, [width, values]] of Object.entries(attributes)) {
      const place = gl.getAttribLocation(program, name);
      gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
      gl.bufferData(gl.ARRAY_BUFFER, values, gl.STATIC_DRAW);
      gl.enableVertexAttribArray(place);
      gl.vertexAttribPointer(place, width, gl.FLOAT, false, 0, 0);
    }
    return array;
  }

  // All triangles: those of the robot, then those of the arrows, then those of the ground.
  build() {
    const all = { position: [], normal: [], color: [], part: [] };
    const add = ({ position, normal }, at, color, part) => {
      for (let i = 0; i < position.length; i += 3) {
        all.position.push(...moved(at, position.slice(i, i + 3)));
        all.normal.push(...turned(at, normal.slice(i, i + 3)));
        all.color.push(...color);
        all.part.push(part);
      }
    };
    const { geoms, meshes, links, feet } = this.content;
    const lay = (geom, part) => add(triangles(geom, meshes), pose(geom.position, geom.quaternion), geom.color, part);
    for (const geom of geoms.filter(({ link }) => link >= 0)) lay(geom, geom.link);
    const robot = all.part.length, still = pose([0, 0, 0], [1, 0, 0, 0]);
    feet.forEach(({ color }, i) => {
      add(cylinder(0.012, 0, 1), still, color, links.length + 2 * i);
      add(cone(0.032, HEAD), still, color, links.length + 2 * i + 1);
    });
    const arrows = all.part.length;
    for (const geom of geoms.filter(({ link }) => link < 0)) lay(overTrack(geom), this.parts - 1); // the ground
    return [all, robot, arrows];
  }

  load({ position, normal, color, part }, robot, arrows) {
    this.counts = { robot: [0, robot], arrows: [robot, arrows - robot], ground: [arrows, part.length - arrows] };
    const floats = (values) => new Float32Array(values);
    this.shapes = this.vertices(this.robot, {
      position: [3, floats(position)], normal: [3, floats(normal)], color: [3, floats(color)], part: [1, floats(part)],
    });
  }

  // The arrows' matrices; one without a force is nowhere.
  arrows(poses, force) {
    return this.content.feet.flatMap(({ link, position }, i) => {
      const newtons = force.slice(3 * i, 3 * i + 3), length = Math.hypot(...newtons) / NEWTONS_A_METRE;
      if (length * NEWTONS_A_METRE < LEAST_FORCE) return [new Array(16).fill(0), new Array(16).fill(0)];
      const sole = moved(poses[link], position), ahead = unit(newtons);
      const tip = sole.map((value, k) => value + ahead[k] * length);
      return [along(sole, newtons, length), along(tip, newtons, 1)];
    });
  }

  // `place` of the trunk, `level` of the ground below it, `poses` centred under it, `force` of 4 x 3 N or null,
  // `camera` {yaw, pitch, distance}.
  draw(place, level, poses, force, { yaw, pitch, distance }) {
    const gl = this.gl, { canvas } = this, wide = canvas.width / canvas.height;
    const tangent = wide > 1.4 ? [FIELD * wide, FIELD] : [FIELD * 1.4, (FIELD * 1.4) / wide];
    const ahead = [-Math.cos(pitch) * Math.cos(yaw), -Math.cos(pitch) * Math.sin(yaw), -Math.sin(pitch)];
    const eye = [0, 0, 0.36].map((value, i) => value - distance * ahead[i]);
    eye[2] = level + Math.max(eye[2], 0.05);
    const camera = view(eye, ahead);
    const world = pose([-place[0], -place[1], 0], [1, 0, 0, 0]);
    const matrices = [...poses, ...this.arrows(poses, force ?? new Array(12).fill(0)), world].flat();

    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT | gl.STENCIL_BUFFER_BIT);
    gl.disable(gl.DEPTH_TEST);
    this.use(this.track, { camera, tangent, eye, origin: [place[0] % 10, place[1]] });
    gl.bindVertexArray(this.screen);
    gl.drawArrays(gl.TRIANGLES, 0, 3);

    gl.bindVertexArray(this.shapes);
    const projection = perspective(tangent[1], tangent[0], 0.05, 60);
    const shared = { camera, projection, parts: matrices, eye, sun: SUN, level: [level], glows: 0 };
    gl.enable(gl.DEPTH_TEST);
    this.use(this.robot, { ...shared, flat_on_ground: 0 });
    gl.drawArrays(gl.TRIANGLES, ...this.counts.ground);
    gl.disable(gl.DEPTH_TEST);
    gl.enable(gl.BLEND);
    gl.blendFuncSeparate(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA, gl.ONE, gl.ONE);
    gl.enable(gl.STENCIL_TEST); // each pixel of the shadow is darkened once
    gl.stencilFunc(gl.EQUAL, 0, 255);
    gl.stencilOp(gl.KEEP, gl.KEEP, gl.INCR);
    this.use(this.robot, { flat_on_ground: 1 });
    gl.drawArrays(gl.TRIANGLES, ...this.counts.robot);
    gl.disable(gl.STENCIL_TEST);
    gl.disable(gl.BLEND);

    gl.enable(gl.DEPTH_TEST);
    this.use(this.robot, { flat_on_ground: 0 });
    gl.drawArrays(gl.TRIANGLES, ...this.counts.robot);
    this.use(this.robot, { glows: 1 });
    gl.drawArrays(gl.TRIANGLES, ...this.counts.arrows);
  }

  use(program, values) {
    const gl = this.gl, setters = { 2: "uniform2fv", 3: "uniform3fv", 1: "uniform1fv" };
    gl.useProgram(program);
    for (const [name, value] of Object.entries(values)) {
      const place = gl.getUniformLocation(program, name);
      if (!Array.isArray(value)) gl.uniform1i(place, value);
      else if (value.length >= 16) gl.uniformMatrix4fv(place, false, value);
      else gl[setters[value.length]](place, value);
    }
  }
}
