"""Demonstrations for camera policies: recoveries in rendered scenes, written as a LeRobot dataset."""
