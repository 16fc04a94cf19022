"""From a policy to a folder that runs on a robot: `bundle` writes it, `onboard` is copied into it."""
