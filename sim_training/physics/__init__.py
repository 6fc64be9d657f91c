"""What the simulated arm's domains share: the SAPIEN scene, parts, surfaces, light, and how bad a camera is."""
