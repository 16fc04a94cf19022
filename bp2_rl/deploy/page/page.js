// What hands do on the page, and what eyes see there. `index.html#policy=FOLDER&robot=NAME&speed=12` says what runs.

const WISHES = [["speed", "m/s"], ["left", "m/s"], ["turn", "rad/s"]];
const STEPS = [0.5, 0.1, 0.1]; // of a wish by a key
const PUSH = 0.8; // m/s, to the left
const KEYS = { W: [1, 0, 0], S: [-1, 0, 0], A: [0, 0, 1], D: [0, 0, -1], Q: [0, 1, 0], E: [0, -1, 0] };
const AXES = [[1, 0], [2, 1], [0, 2]]; // of a gamepad: right and down are positive; and the wish that each sets
const REST = 0.15; // share of a stick's way that means nothing
const BUTTONS = { 0: "F", 1: "X", 3: "R", 4: "S", 5: "W", 6: "Q", 7: "E", 9: "G", 12: "W", 13: "S", 14: "A", 15: "D" };
const CAMERAS = [{ yaw: -2.4, pitch: 0.13, distance: 3 }, VIEWS.side, VIEWS.front, VIEWS.above];
const DOWN_FOR = 1.5; // s, for which a fallen robot lies before it stands again
const MOST_WORK = 0.05; // s, in which a picture's physics must be done, or else time slows down

const find = (selector) => document.querySelector(selector);
const shows = (name) => find(`[data-shows=${name}]`);
const says = (text) => { find("#says").textContent = text; };
const fail = (reason) => says(`This page does not work here: ${reason.message}.`);

class Page {
  constructor(mujoco, asked, content) {
    Object.assign(this, { mujoco, asked, content, camera: new Camera(), best: Infinity, slow: 1, owed: 0, held: {}, level: 0 });
    this.canvas = find("canvas");
    this.look();
    this.camera.follow(this.canvas, () => {}, () => true);
    this.build();
  }

  // Elements that depend on the policy, and what hands do to them all.
  build() {
    const { least, most } = this.content.command, names = Object.keys(this.content.robots);
    document.title = `${this.content.name} runs`;
    find("[data-does=robot]").replaceChildren(...names.map((name) => new Option(name)));
    find("[data-does=robot]").hidden = names.length < 2;
    document.querySelectorAll("[data-wish]").forEach((slider) => {
      const i = Number(slider.dataset.wish);
      [slider.min, slider.max, slider.value] = [least[i], most[i], 0];
      slider.closest("label").hidden = least[i] === most[i];
      slider.addEventListener("input", () => this.ask(i, Number(slider.value)));
    });
    document.querySelectorAll("[data-key]").forEach((button) => {
      button.addEventListener("click", () => { this.press(button.dataset.key); button.blur(); });
    });
    const on = (name, does) => find(`[data-does=${name}]`).addEventListener("change", ({ target }) => does(target));
    on("robot", ({ value }) => this.take(value).then(() => this.remember(), fail));
    on("slow", ({ value }) => { this.slow = Number(value); });
    find("[data-does=link]").addEventListener("click", () => this.copy());
    addEventListener("keydown", (event) => {
      const theirs = event.target.matches(event.key.startsWith("Arrow") ? "input, select" : "select"); // of an element
      if (theirs || event.ctrlKey || event.metaKey || event.altKey) return;
      const arrows = { ArrowUp: "W", ArrowDown: "S", ArrowLeft: "A", ArrowRight: "D" };
      if (this.press(arrows[event.key] ?? event.key.toUpperCase())) event.preventDefault();
    });
    addEventListener("hashchange", () => location.reload());
    const rivals = Object.keys(this.content.rivals);
    shows("lane").innerHTML = ["this robot", ...rivals].map((name) => `<i><span>${name}</span></i>`).join("");
  }

  // Let another of the policy's robots run.
  async take(name) {
    const robot = await Robot.load(this.mujoco, this.asked.policy, name, this.content);
    this.robot?.free();
    this.robot = robot;
    this.asked.robot = find("[data-does=robot]").value = name;
    this.scene = new Scene(this.canvas, this.content.robots[name].scene);
    this.reset();
  }

  reset() {
    this.robot.reset();
    Object.assign(this, { began: null, sprint: 0, finished: false, fell: null, speeds: [] });
    says("");
  }

  // --- Hands ----------------------------------------------------------------------------

  ask(i, value) {
    const { least, most } = this.content.command;
    this.robot.wish[i] = Math.min(Math.max(Math.round(1e6 * value) / 1e6, least[i]), most[i]);
    if (i === 0) this.remember();
  }

  press(key) {
    const { wish } = this.robot, most = this.content.command.most[0];
    if (key in KEYS) KEYS[key].forEach((steps, i) => { if (steps) this.ask(i, wish[i] + steps * STEPS[i]); });
    else if (key === "X") wish.fill(0);
    else if (key === "F") this.ask(0, most);
    else if (key === "R") this.reset();
    else if (key === "P") this.robot.look().qvel[1] += PUSH;
    else if (key === "V") this.look();
    else if (key === "G") { this.reset(); this.ask(0, most); }
    else return false;
    return true;
  }

  look() { // from the next place
    this.view = ((this.view ?? -1) + 1) % CAMERAS.length;
    Object.assign(this.camera, CAMERAS[this.view]);
    if (innerWidth < innerHeight) this.camera.distance *= 0.75; // a telephone
  }

  hearGamepad() {
    const pad = [...(navigator.getGamepads?.() ?? [])].find((each) => each?.connected);
    const { least, most } = this.content.command;
    for (const [axis, i] of AXES) {
      const x = -(pad?.axes[axis] ?? 0), share = (Math.sign(x) * Math.max(Math.abs(x) - REST, 0)) / (1 - REST);
      if (share !== (this.held[`axis ${i}`] ?? 0)) this.ask(i, share * (share < 0 ? -least[i] : most[i]));
      this.held[`axis ${i}`] = share;
    }
    for (const [i, key] of Object.entries(BUTTONS)) {
      const pressed = Boolean(pad?.buttons[i]?.pressed);
      if (pressed && !this.held[i]) this.press(key);
      this.held[i] = pressed;
    }
  }

  remember() {
    const { policy, robot } = this.asked, speed = Number(this.robot.wish[0].toFixed(2));
    history.replaceState(null, "", `#${new URLSearchParams({ policy, robot, speed })}`);
  }

  async copy() {
    this.remember();
    const button = find("[data-does=link]");
    try {
      await navigator.clipboard.writeText(location.href);
      button.textContent = "Copied";
    } catch { // a page without https may not
      button.textContent = "See address bar";
    }
    setTimeout(() => { button.textContent = "Copy link"; }, 2000);
  }

  get speed() { // mean of a stride, m/s
    return this.speeds.reduce((sum, speed) => sum + speed, 0) / Math.max(this.speeds.length, 1);
  }

  // --- Time -----------------------------------------------------------------------------

  // A millisecond, with the clock and what comes after a fall.
  step() {
    const { robot, content } = this;
    robot.step();
    this.speeds.push(robot.speed);
    if (this.speeds.length > 1000 * content.ripple) this.speeds.shift();
    if (this.began === null && robot.wish.some(Boolean)) this.began = robot.time;
    if (robot.milliseconds % 5) return;
    if (this.fell === null && robot.down) {
      this.fell = robot.time;
      robot.wish.fill(0);
      says(`It fell at ${this.speed.toFixed(1)} m/s${robot.fault && `; its watchdog had stopped the policy: ${robot.fault}`}.`);
    }
    if (robot.exploded || (this.fell !== null && robot.time > this.fell + DOWN_FOR)) return this.reset();
    if (this.began === null || this.finished || this.fell !== null) return;
    this.sprint = robot.time - this.began;
    this.finished = robot.look().qpos[0] >= content.track;
    if (this.finished) this.best = Math.min(this.best, this.sprint);
  }

  // Steps the robot without pictures; returns the metres run, the seconds it took and whether the robot fell.
  run(seconds, speed) {
    this.ask(0, speed);
    const started = performance.now(), from = this.robot.look().qpos[0];
    for (let k = 0; k < 1000 * seconds && this.fell === null; k++) this.step();
    return { metres: this.robot.look().qpos[0] - from, took: (performance.now() - started) / 1000, fell: this.fell };
  }

  start() {
    let last = performance.now();
    const picture = (now) => {
      const passed = Math.min(Math.max(now - last, 0) / 1000, 0.1) / this.slow, began = performance.now();
      last = now;
      this.hearGamepad();
      this.owed += passed;
      while (this.owed >= 0.001 && performance.now() - began < 1000 * MOST_WORK) {
        this.step();
        this.owed -= 0.001;
      }
      this.owed = Math.min(this.owed, 0.001); // what could not be done is not caught up with
      this.show();
      requestAnimationFrame(picture);
    };
    requestAnimationFrame(picture);
  }

  // --- Eyes -----------------------------------------------------------------------------

  show() {
    const { canvas, robot } = this, sharp = Math.min(devicePixelRatio, 2);
    const size = [canvas.clientWidth, canvas.clientHeight].map((length) => Math.max(Math.round(length * sharp), 1));
    if (canvas.width !== size[0] || canvas.height !== size[1]) [canvas.width, canvas.height] = size;
    const place = [...robot.look().qpos.subarray(0, 3)], forces = find("[data-does=forces]").checked;
    this.level += 0.1 * (place[2] - robot.height - this.level);
    this.scene.draw(place, this.level, robot.poses(), forces ? robot.forces : null, this.camera);
    this.tell(place[0]);
  }

  tell(x) {
    const { robot, content, sprint, speed } = this;
    shows("speed").textContent = (Math.abs(speed) < 0.05 ? 0 : speed).toFixed(1);
    shows("told").textContent = `${Math.abs(3.6 * speed).toFixed(0)} km/h, told ${robot.told[0].toFixed(1)} m/s`;
    shows("clock").textContent = sprint.toFixed(2);
    const best = this.best < Infinity ? `, best ${this.best.toFixed(2)} s` : "";
    shows("run").textContent = this.finished ? `100 m done${best}` : `${Math.max(x, 0).toFixed(0)} m of ${content.track}${best}`;
    WISHES.forEach(([name, unit], i) => {
      shows(`${name}-wish`).textContent = `${robot.wish[i].toFixed(2)} ${unit}`;
      const slider = find(`[data-wish="${i}"]`);
      if (document.activeElement !== slider || Number(slider.value) !== robot.wish[i]) slider.value = robot.wish[i];
    });
    const time = this.began === null ? 0 : robot.time - this.began;
    const metres = [x, ...Object.values(content.rivals).map((splits) => place_of(splits, time, content.track))];
    [...shows("lane").children].forEach((mark, i) => {
      mark.style.left = `${Math.min(Math.max(metres[i] / content.track, 0), 1) * 100}%`;
    });
  }
}

// Where a runner is who passes equal parts of the track at these times.
function place_of(splits, time, track) {
  const part = track / splits.length, next = splits.findIndex((split) => split > time);
  if (next < 0) return track;
  const before = next > 0 ? splits[next - 1] : 0;
  return part * (next + (time - before) / (splits[next] - before));
}

async function main() {
  if (location.protocol === "file:") return says("Browsers do not run this page from a disk: python -m http.server in its folder.");
  if (typeof WebAssembly !== "object") return says("This browser has no WebAssembly, without which nothing runs here.");
  says("Loading the robot and its physics, 7 MB ...");
  const asked = Object.fromEntries(new URLSearchParams(location.hash.slice(1)));
  if (!/^[\w-]+$/.test(asked.policy ?? "")) asked.policy = "policy";
  const decoder = new TextDecoder(), content = JSON.parse(decoder.decode(await bytes(`${asked.policy}/page.json`)));
  const [{ default: load }, wasmBinary] = await Promise.all([import("./mujoco.js"), bytes("mujoco.wasm.gz")]);
  const page = new Page(await load({ wasmBinary }), asked, content), { robots, speed } = content;
  await page.take(asked.robot in robots ? asked.robot : Object.keys(robots)[0]);
  for (const part of ["header", "footer"]) find(part).hidden = false;
  page.ask(0, Number.isFinite(parseFloat(asked.speed)) ? parseFloat(asked.speed) : speed);
  page.start();
  globalThis.page = page;
}

main().catch(fail);
