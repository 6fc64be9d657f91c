"""The object types that simulator, perception and skills agree on. World frame, metres, radians, wxyz."""

from resync_robot.core.symbols import Type

POSE = ("x", "y", "z", "qw", "qx", "qy", "qz")

# The pose of a robot is that of its tool centre point: between the finger tips, z out of the hand.
# `opening` is the free distance between the finger pads.
ROBOT = Type("robot", (*POSE, "opening"))

# The pose of a block is that of the centre of its body (the stud on top not counted), z out of the stud.
# `size_x`, `size_y`, `size_z` are the body's full extents.
BLOCK = Type("block", (*POSE, "size_x", "size_y", "size_z"))

# The pose of a box is that of the middle of its floor's upper face, z out of the opening.
# `inner_x`, `inner_y` are the full interior extents, `wall_z` the height of the walls above the floor.
BOX = Type("box", (*POSE, "inner_x", "inner_y", "wall_z", "wall_thickness"))

# The pose of a lid is that of the centre of its plate (the knob not counted), z up. `size_x`, `size_y`, `size_z` are
# the plate's full extents.
LID = Type("lid", (*POSE, "size_x", "size_y", "size_z"))

# The pose of a drawer is that of the centre of its front, x the way it is pulled, z up. `opening` is the distance
# between front and cabinet, `size_x`, `size_y`, `size_z` are the front's full extents.
DRAWER = Type("drawer", (*POSE, "opening", "size_x", "size_y", "size_z"))

TYPES = {t.name: t for t in (ROBOT, BLOCK, BOX, LID, DRAWER)}
