"""Drivers behind three protocols, the safety gate in front of them, and the setpoint stream that feeds them."""
