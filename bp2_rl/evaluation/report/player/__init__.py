"""The 3D player of a run in a report's page: plain JavaScript and WebGL 2, without
other files or network.

content        what the page is told: the robot's links and looks, and its motion
linear.js      quaternions and matrices
shapes.js      geoms as triangles
motion.js      where the links are at an instant
camera.js      the camera under a hand
scene.js       track, shadow, robot and forces on the canvas
controls.js    play, slow motion, scrubbing
player.html    the elements, player.css their look; `report/benchmark.html` puts all into the page
"""
