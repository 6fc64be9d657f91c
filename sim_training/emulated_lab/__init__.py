"""An emulated lab: a simulated world behind the protocols of a real machine."""
