"""The object types that simulator, perception and skills agree on. World frame, metres, radians, wxyz."""

from resync_robot.core.symbols import SE3, Type

_SIZE = ("size_x", "size_y", "size_z")

# The pose of a robot is that of its tool centre point: between the finger tips, z out of the hand.
# `opening` is the free distance between the finger pads.
ROBOT = Type("robot", (*SE3, "opening"), pose=SE3, symmetry=2, exact=True)

# The pose of a block is that of the centre of its body (the stud on top not counted), z out of the stud.
# `size_x`, `size_y`, `size_z` are the body's full extents; its footprint is a square.
BLOCK = Type("block", (*SE3, *_SIZE), pose=SE3, extents=_SIZE, symmetry=4)

# The pose of a box is that of the middle of its floor's upper face, z out of the opening.
# `inner_x`, `inner_y` are the full interior extents, `wall_z` the height of the walls above the floor. It is hollow, so
# none of them is the extent of a body.
BOX = Type("box", (*SE3, "inner_x", "inner_y", "wall_z", "wall_thickness"), pose=SE3, symmetry=2)

# The pose of a lid is that of the centre of its plate (the knob not counted), z up. `size_x`, `size_y`, `size_z` are
# the plate's full extents.
LID = Type("lid", (*SE3, *_SIZE), pose=SE3, extents=_SIZE, symmetry=2)

# The pose of a drawer is that of the centre of its front, x the way it is pulled, z up. `opening` is the distance
# between front and cabinet, `size_x`, `size_y`, `size_z` are the front's full extents.
DRAWER = Type("drawer", (*SE3, "opening", *_SIZE), pose=SE3, extents=_SIZE)

TYPES = {t.name: t for t in (ROBOT, BLOCK, BOX, LID, DRAWER)}
