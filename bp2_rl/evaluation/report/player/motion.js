// The recorded motion, and where that puts the robot's links.

function numbers({ data, type, scale, width }) {
  const bytes = Uint8Array.from(atob(data), (letter) => letter.charCodeAt(0));
  const values = type === "f4" ? new Float32Array(bytes.buffer) : new Int16Array(bytes.buffer);
  return (k, i) => values[k * width + i] * scale[i % scale.length];
}

class Motion {
  constructor(content) {
    Object.assign(this, content.motion); // rate, count, start, best, fell
    this.channels = Object.fromEntries(Object.entries(content.channels).map(([name, c]) => [name, numbers(c)]));
    this.links = content.links;
    this.length = (this.count - 1) / this.rate; // s
  }

  // Channel `name`, `width` numbers, at `seconds` after the first sample: straight between two samples.
  at(name, width, seconds) {
    const place = Math.min(Math.max(seconds * this.rate, 0), this.count - 1), k = Math.floor(place), part = place - k;
    const next = Math.min(k + 1, this.count - 1), value = this.channels[name], out = [];
    for (let i = 0; i < width; i++) out.push((1 - part) * value(k, i) + part * value(next, i));
    return out;
  }

  // The pose of every link, with the world's origin under the trunk if `centred`.
  poses(seconds, centred) {
    const place = this.at("place", 3, seconds), joints = this.at("joints", this.links.length - 1, seconds);
    const trunk = pose(centred ? [0, 0, place[2]] : place, unit(this.at("turn", 4, seconds)));
    const out = [trunk];
    this.links.slice(1).forEach((link, i) => {
      const hinge = link.joint === "hinge", angle = joints[i];
      const at = hinge ? pose([0, 0, 0], about(link.axis, angle)) : pose(link.axis.map((x) => x * angle), [1, 0, 0, 0]);
      out.push(product(product(out[link.parent], pose(link.position, link.quaternion)), at));
    });
    return out;
  }
}
