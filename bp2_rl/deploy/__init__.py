"""Deployment: `bundle` writes a policy as a folder that runs on a robot, with the code
in `onboard`."""
