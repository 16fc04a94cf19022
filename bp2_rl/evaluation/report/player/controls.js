// The page's elements and the hand on them.

class Player {
  constructor(element, content) {
    this.find = (selector) => element.querySelector(selector);
    this.canvas = this.find("canvas");
    this.motion = new Motion(content);
    this.scene = new Scene(this.canvas, content);
    this.camera = new Camera();
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
      button.addEventListener("click", () => { Object.assign(this.camera, VIEWS[button.dataset.view]); this.show(); });
    this.canvas.addEventListener("keydown", (event) => this.key(event));
    // without Ctrl the page scrolls past
    this.camera.follow(this.canvas, () => this.show(), (wheel) => wheel.ctrlKey || document.fullscreenElement);
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
