"""Deployment: `bundle` writes a policy as a folder that runs on a robot, and copies
`onboard` into the folder."""
