"""A policy's robot on a page in a browser, simulated there: plain JavaScript and
WebAssembly.

folder         what a page's folder holds, and how it is written
mujoco_wasm    MuJoCo's own build for browsers, checked before it is used
bp2_motors.hpp motors, losses and operator, beside the controller of `deploy/cpp`
page.cpp       these for a browser; `build` compiles them to page.wasm
robot.js       the robot in the browser: physics, motors and controller together
page.js        what hands do and eyes see; page.html the elements, page.css their look

The picture is that of a report's player: `evaluation/report/player`.
"""
