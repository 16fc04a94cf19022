// Steers with a gamepad: tells the server each move of a stick, in per cent, and a
// pressed button's key. A stick at rest, gone or on a hidden page is at 0.
(() => {
  if (window.bp2Pad) return; // the page runs this again after it lost the server
  window.bp2Pad = true;
  const AXES = { 1: "speed", 0: "turn", 2: "left" };
  const KEYS = {
    0: "F", 1: "X", 3: "R", // A, B, Y
    4: "S", 5: "W", 6: "Q", 7: "E", // shoulders, left and right, above and below
    12: "W", 13: "S", 14: "A", 15: "D", // cross
  };
  const REST = 0.15; // share of a stick's way that means nothing
  const place = `${location.origin.replace(/^http/, "ws")}/pad`;
  const at = {}, held = {};
  let socket;

  function tell(text) {
    if (!socket || socket.readyState > WebSocket.OPEN) socket = new WebSocket(place);
    if (socket.readyState === WebSocket.OPEN) socket.send(text);
    else socket.addEventListener("open", ({ target }) => target.send(text));
  }

  setInterval(() => {
    const pads = document.hidden ? [] : navigator.getGamepads?.() ?? [];
    const pad = [...pads].find((each) => each?.connected);
    for (const [i, part] of Object.entries(AXES)) {
      const x = pad?.axes[i] ?? 0; // right and down are positive
      const share = Math.max(Math.abs(x) - REST, 0) / (1 - REST);
      const percent = Math.min(Math.round(-100 * Math.sign(x) * share), 100);
      if (percent !== (at[part] ?? 0)) tell(`${part} ${(at[part] = percent)}`);
    }
    for (const [i, key] of Object.entries(KEYS)) {
      const pressed = Boolean(pad?.buttons[i]?.pressed);
      if (pressed && !held[i]) tell(key);
      held[i] = pressed;
    }
  }, 50);
})();
