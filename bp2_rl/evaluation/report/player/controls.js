// The page's elements and the hand on them.

const VIEWS = {
  side: { yaw: -Math.PI / 2 + 0.22, pitch: 0.15, distance: 2.5 },
  front: { yaw: -0.75, pitch: 0.16, distance: 2.5 },
  above: { yaw: -Math.PI / 2, pitch: 1.2, distance: 3 },
};
const NEAREST = 0.8, FURTHEST = 12; // m
const RADIANS_A_PIXEL = 0.008;

class Player {
  constructor(element, content) {
    this.find = (selector) => element.querySelector(selector);
    this.canvas = this.find("canvas");
    this.motion = new Motion(content);
    this.scene = new Scene(this.canvas, content);
    this.camera = { ...VIEWS.side };
    this.seconds = this.motion.best;
    this.playing = false;
    this.slow = 1;
    element.hidden = false;
    this.listen(element);
    this.fill(content);
    new ResizeObserver(() => this.show()).observe(this.canvas);
    this.show();
  }

  // What does not change: the speed behind the slider, the colours of the feet.
  fill({ feet, links }) {
    const { length } = this.motion, steps = 300, speeds = [];
    for (let i = 0; i <= steps; i++) speeds.push(Math.max(this.motion.at("speed", 2, (length * i) / steps)[0], 0));
    const most = Math.max(...speeds, 0.1);
    const points = speeds.map((v, i) => `${((1000 * i) / steps).toFixed(1)} ${(100 - (88 * v) / most).toFixed(1)}`);
    this.find(".scrub path").setAttribute("d", `M0 100L${points.join("L")}L1000 100Z`);
    this.find(".scrub input").max = length;
    const css = (color) => `rgb(${color.map((value) => Math.round(255 * value)).join(" ")})`;
    const names = feet.map(({ link, color }) => `<i style="background:${css(color)}"></i>${links[link].name.slice(0, 2)}`);
    this.find("[data-shows=feet]").innerHTML = names.join("");
  }

  listen(element) {
    const on = (selector, event, does) => this.find(selector).addEventListener(event, does);
    on("[data-does=play]", "click", () => this.play(!this.playing));
    on("[data-does=best]", "click", () => this.seek(Math.max(this.motion.best - 0.5, 0)));
    on("[data-does=slow]", "change", (event) => { this.slow = Number(event.target.value); });
    on("[data-does=forces]", "change", () => this.show());
    on(".scrub input", "input", (event) => this.seek(Number(event.target.value)));
    on("[data-does=full]", "click", () => this.find(".stage").requestFullscreen?.());
    for (const button of element.querySelectorAll("[data-view]"))
      button.addEventListener("click", () => { this.camera = { ...VIEWS[button.dataset.view] }; this.show(); });
    this.canvas.addEventListener("keydown", (event) => this.key(event));
    this.canvas.addEventListener("wheel", (event) => {
      if (!event.ctrlKey && !document.fullscreenElement) return; // or the page could not be scrolled past
      event.preventDefault();
      this.near(Math.exp(event.deltaY * 0.002));
    }, { passive: false });
    const held = new Map();
    this.canvas.addEventListener("pointerdown", (event) => {
      held.set(event.pointerId, event);
      this.canvas.setPointerCapture(event.pointerId);
    });
    for (const end of ["pointerup", "pointercancel"])
      this.canvas.addEventListener(end, (event) => held.delete(event.pointerId));
    this.canvas.addEventListener("pointermove", (event) => {
      if (!held.has(event.pointerId)) return;
      const before = held.get(event.pointerId), other = [...held.values()].find((e) => e.pointerId !== event.pointerId);
      const far = (e) => Math.hypot(e.clientX - other.clientX, e.clientY - other.clientY);
      if (other) this.near(far(before) / Math.max(far(event), 1));
      else this.orbit(event.clientX - before.clientX, event.clientY - before.clientY);
      held.set(event.pointerId, event);
    });
  }

  orbit(right, down) {
    this.camera.yaw -= RADIANS_A_PIXEL * right;
    this.camera.pitch = Math.min(Math.max(this.camera.pitch + RADIANS_A_PIXEL * down, -0.1), 1.5);
    this.show();
  }

  near(factor) {
    this.camera.distance = Math.min(Math.max(this.camera.distance * factor, NEAREST), FURTHEST);
    this.show();
  }

  key(event) {
    const step = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
    if (event.key === " ") this.play(!this.playing);
    else if (step) this.seek(this.seconds + step / this.motion.rate);
    else return;
    event.preventDefault();
  }

  seek(seconds) {
    this.seconds = Math.min(Math.max(seconds, 0), this.motion.length);
    this.show();
  }

  play(on) {
    this.playing = on;
    if (on && this.seconds >= this.motion.length) this.seconds = 0;
    const button = this.find("[data-does=play]");
    button.textContent = on ? "\u275a\u275a" : "\u25b6";
    button.setAttribute("aria-label", on ? "Pause" : "Play");
    let last = null;
    const tick = (now) => {
      if (!this.playing || last === "ended") return;
      if (last !== null) this.seek(this.seconds + Math.min(now - last, 250) / 1000 / this.slow);
      last = now;
      if (this.seconds >= this.motion.length) this.play(false);
      else requestAnimationFrame(tick);
    };
    if (on) requestAnimationFrame(tick);
  }

  show() {
    const { canvas, motion, seconds } = this, sharp = Math.min(window.devicePixelRatio, 2);
    const [width, height] = [canvas.clientWidth, canvas.clientHeight].map((size) => Math.max(Math.round(size * sharp), 1));
    if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
    const force = this.find("[data-does=forces]").checked ? motion.at("force", 12, seconds) : null;
    const place = motion.at("place", 3, seconds), [speed, told] = motion.at("speed", 2, seconds);
    const [level] = motion.at("level", 1, seconds);
    this.scene.draw(place, level, motion.poses(seconds, true), force, this.camera);
    this.find("[data-shows=speed]").textContent = speed.toFixed(1);
    const falls = motion.fell !== null && seconds >= motion.length ? ", falls" : "";
    this.find("[data-shows=told]").textContent = `told ${told.toFixed(1)} m/s, ${place[0].toFixed(0)} m${falls}`;
    this.find("[data-shows=time]").textContent = `${(motion.start + seconds).toFixed(2)} s`;
    this.find(".scrub input").value = seconds;
  }
}

const element = document.querySelector(".player");
try {
  element.player = new Player(element, JSON.parse(document.getElementById("run-content").textContent));
} catch (reason) {
  const said = document.createElement("p");
  said.className = "quiet";
  said.textContent = `The run is not shown in three dimensions here (${reason.message}); film and plots show it.`;
  element.replaceWith(said);
}
