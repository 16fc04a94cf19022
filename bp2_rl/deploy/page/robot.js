// The robot in the browser: MuJoCo's physics, and the motors, losses and controller of page.wasm.

const SHARED = { qpos: 23, qvel: 22, after: 22, mobility: 12, wish: 3, torque: 12, force: 22, told: 3 }; // as page.cpp
const TRIALS = 12; // of a millisecond in which a torque leaves the envelope, at most
const MILLISECONDS = 5; // of a control step
const DOWN = [0, 0, -1], GROUND = [1, 0, 0, 0, 0, 0]; // the first of MuJoCo's groups of geoms

async function bytes(path) {
  const answer = await fetch(path);
  if (!answer.ok) throw new Error(`the server has no ${path}`);
  const content = new Uint8Array(await answer.arrayBuffer());
  if (content[0] !== 0x1f || content[1] !== 0x8b) return content; // some servers unpack .gz themselves
  const unpacked = new Blob([content]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Uint8Array(await new Response(unpacked).arrayBuffer());
}

class Robot {
  // The last argument is the content of page.json.
  static async load(mujoco, folder, name, { robots, fall }) {
    const files = ["page.wasm", `${folder}/controller.bin.gz`, `${folder}/${name}.bin`, `${folder}/${name}.xml`];
    const [code, controller, numbers, xml] = await Promise.all(files.map(bytes));
    const wasi = new Proxy({}, { get: () => () => 8 }); // there are no files
    const { instance } = await WebAssembly.instantiate(code, { wasi_snapshot_preview1: wasi });
    instance.exports._initialize();
    return new Robot(mujoco, instance.exports, [controller, numbers], new TextDecoder().decode(xml), robots[name], fall);
  }

  constructor(mujoco, code, files, xml, design, fall) {
    Object.assign(this, { mujoco, code, design, fall });
    const given = files.flatMap((content) => {
      const place = code.room(content.length);
      new Uint8Array(code.memory.buffer, place, content.length).set(content);
      return [place, content.length];
    });
    const wrong = this.text(code.load(...given));
    if (wrong) throw new Error(wrong);
    let place = code.numbers();
    for (const [name, size] of Object.entries(SHARED)) {
      this[name] = new Float64Array(code.memory.buffer, place, size);
      place += 8 * size;
    }
    this.model = mujoco.MjModel.from_xml_string(xml);
    Object.assign(this.model.opt, design.solver);
    this.data = new mujoco.MjData(this.model);
    const { nv } = this.model, leg = (nv - 6) / 4;
    this.joints = Array.from({ length: 12 }, (_, i) => 6 + leg * Math.floor(i / 3) + (i % 3));
    this.units = this.joints.flatMap((at) => Array.from({ length: nv }, (_, i) => Number(i === at)));
    this.answer = new mujoco.DoubleBuffer(12 * nv);
    this.reset();
  }

  free() {
    for (const part of [this.answer, this.data, this.model]) part.delete();
  }

  text(place) {
    const letters = new Uint8Array(this.code.memory.buffer, place);
    return new TextDecoder().decode(letters.subarray(0, letters.indexOf(0)));
  }

  // Views of MuJoCo's memory, which move when it grows.
  look() {
    if (this.state?.qpos.length) return this.state;
    const { qpos, qvel, qacc_warmstart, ctrl, qfrc_applied, xpos, xquat, sensordata } = this.data;
    this.state = { qpos, qvel, qacc_warmstart, ctrl, qfrc_applied, xpos, xquat, sensordata };
    return this.state;
  }

  reset() {
    const { mujoco, model, data, code } = this;
    mujoco.mj_resetData(model, data);
    code.reset();
    const state = this.look();
    state.qpos.set(this.design.stand);
    state.ctrl.set(this.torque);
    mujoco.mj_forward(model, data);
    this.wish.fill(0);
    this.forces = new Array(12).fill(0); // N, of the ground on the feet, smoothed
    this.fault = "";
    this.milliseconds = 0;
  }

  // A millisecond; with every fifth a control step begins.
  step() {
    const k = this.milliseconds++ % MILLISECONDS;
    this.tell();
    if (k === 0) this.fault = this.text(this.code.tick());
    this.code.drive(k);
    this.advance();
    this.look().sensordata.forEach((newtons, i) => { this.forces[i] += (newtons - this.forces[i]) / MILLISECONDS; });
  }

  tell() {
    const { qpos, qvel } = this.look();
    this.qpos.set(qpos);
    this.qvel.set(qvel);
  }

  advance() {
    const { mujoco, model, data, design } = this, { time } = data;
    const warm = this.look().qacc_warmstart.slice();
    for (let trial = 0; ; trial++) {
      const now = this.look();
      now.ctrl.set(this.torque);
      now.qfrc_applied.set(this.force.subarray(0, model.nv));
      mujoco.mj_step(model, data);
      if (!design.throughout || trial === TRIALS) break;
      if (trial === 0) this.mobility.set(this.mobilities());
      this.after.set(this.look().qvel);
      if (!this.code.correct()) break;
      const then = this.look();
      then.qpos.set(this.qpos.subarray(0, model.nq));
      then.qvel.set(this.qvel.subarray(0, model.nv));
      then.qacc_warmstart.set(warm);
      data.time = time;
    }
  }

  // Each joint's acceleration by its own torque, at the start of the last physics step.
  mobilities() {
    this.mujoco.mj_solveM(this.model, this.data, this.answer, this.units);
    const answer = this.answer.GetView();
    return this.joints.map((at, i) => answer[i * this.model.nv + at]);
  }

  get time() { // s
    return this.milliseconds / 1000;
  }

  get height() { // of the trunk over the ground, m
    const from = [...this.look().qpos.subarray(0, 3)];
    return this.mujoco.mj_ray(this.model, this.data, from, DOWN, GROUND, true, -1, null, null);
  }

  get exploded() {
    const { qpos, qvel } = this.look();
    return !(qpos.every(Number.isFinite) && qvel.every((rate) => Math.abs(rate) <= this.fall.max_speed));
  }

  get down() {
    const { qpos } = this.look(), up = 1 - 2 * (qpos[4] ** 2 + qpos[5] ** 2);
    return this.exploded || !(this.height >= this.fall.min_height) || !(up >= this.fall.min_up);
  }

  get speed() { // along the heading, m/s
    const { qpos: q, qvel } = this.look();
    const yaw = Math.atan2(2 * (q[3] * q[6] + q[4] * q[5]), 1 - 2 * (q[5] ** 2 + q[6] ** 2));
    return Math.cos(yaw) * qvel[0] + Math.sin(yaw) * qvel[1];
  }

  // Matrices of all links, with the world's origin under the trunk.
  poses() {
    const { xpos, xquat, qpos } = this.look(), links = [];
    for (let i = 1; i < this.model.nbody; i++) {
      const [x, y, z] = xpos.subarray(3 * i);
      links.push(pose([x - qpos[0], y - qpos[1], z], xquat.subarray(4 * i, 4 * i + 4)));
    }
    return links;
  }
}
