// The camera, and the hand that turns it and brings it nearer.

const VIEWS = {
  side: { yaw: -Math.PI / 2 + 0.22, pitch: 0.15, distance: 2.5 },
  front: { yaw: -0.75, pitch: 0.16, distance: 2.5 },
  above: { yaw: -Math.PI / 2, pitch: 1.2, distance: 3 },
};
const NEAREST = 0.8, FURTHEST = 12; // m
const RADIANS_A_PIXEL = 0.008;

class Camera {
  constructor() {
    Object.assign(this, VIEWS.side);
  }

  orbit(right, down) {
    this.yaw -= RADIANS_A_PIXEL * right;
    this.pitch = Math.min(Math.max(this.pitch + RADIANS_A_PIXEL * down, -0.1), 1.5);
  }

  near(factor) {
    this.distance = Math.min(Math.max(this.distance * factor, NEAREST), FURTHEST);
  }

  // Follows a hand on the canvas, and calls `show` at each move; a wheel counts where `zooms` says so of its event.
  follow(canvas, show, zooms) {
    canvas.addEventListener("wheel", (event) => {
      if (!zooms(event)) return;
      event.preventDefault();
      this.near(Math.exp(event.deltaY * 0.002));
      show();
    }, { passive: false });
    const held = new Map();
    canvas.addEventListener("pointerdown", (event) => {
      held.set(event.pointerId, event);
      canvas.setPointerCapture(event.pointerId);
    });
    for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, (event) => held.delete(event.pointerId));
    canvas.addEventListener("pointermove", (event) => {
      if (!held.has(event.pointerId)) return;
      const before = held.get(event.pointerId), other = [...held.values()].find((e) => e.pointerId !== event.pointerId);
      const far = (e) => Math.hypot(e.clientX - other.clientX, e.clientY - other.clientY);
      if (other) this.near(far(before) / Math.max(far(event), 1));
      else this.orbit(event.clientX - before.clientX, event.clientY - before.clientY);
      held.set(event.pointerId, event);
      show();
    });
  }
}
