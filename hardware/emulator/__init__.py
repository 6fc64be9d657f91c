"""A UR e-Series controller and a Robotiq gripper on loopback, for clients that know nothing of it.

What it promises is what clients can see on the wire: protocols, state machines, timing and faults. How the arm moves
is up to the `PhysicsArm` behind it.
"""
