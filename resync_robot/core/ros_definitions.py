"""The definitions of the messages of ROS 2 that a recording holds, as ROS 2 writes them beside the messages."""

from __future__ import annotations

_FIELDS = {
    "builtin_interfaces/Duration": "int32 sec, uint32 nanosec",
    "builtin_interfaces/Time": "int32 sec, uint32 nanosec",
    "geometry_msgs/Point": "float64 x, float64 y, float64 z",
    "geometry_msgs/Pose": "geometry_msgs/Point position, geometry_msgs/Quaternion orientation",
    "geometry_msgs/Quaternion": "float64 x, float64 y, float64 z, float64 w",
    "geometry_msgs/Transform": "geometry_msgs/Vector3 translation, geometry_msgs/Quaternion rotation",
    "geometry_msgs/TransformStamped": (
        "std_msgs/Header header, string child_frame_id, geometry_msgs/Transform transform"
    ),
    "geometry_msgs/Vector3": "float64 x, float64 y, float64 z",
    "geometry_msgs/Wrench": "geometry_msgs/Vector3 force, geometry_msgs/Vector3 torque",
    "geometry_msgs/WrenchStamped": "std_msgs/Header header, geometry_msgs/Wrench wrench",
    "rcl_interfaces/Log": (
        "builtin_interfaces/Time stamp, uint8 level, string name, string msg, string file, string function, uint32 line"
    ),
    "sensor_msgs/CameraInfo": (
        "std_msgs/Header header, uint32 height, uint32 width, string distortion_model, float64[] d, float64[9] k, "
        "float64[9] r, float64[12] p, uint32 binning_x, uint32 binning_y, sensor_msgs/RegionOfInterest roi"
    ),
    "sensor_msgs/CompressedImage": "std_msgs/Header header, string format, uint8[] data",
    "sensor_msgs/Image": (
        "std_msgs/Header header, uint32 height, uint32 width, string encoding, uint8 is_bigendian, uint32 step, "
        "uint8[] data"
    ),
    "sensor_msgs/JointState": (
        "std_msgs/Header header, string[] name, float64[] position, float64[] velocity, float64[] effort"
    ),
    "sensor_msgs/PointCloud2": (
        "std_msgs/Header header, uint32 height, uint32 width, sensor_msgs/PointField[] fields, bool is_bigendian, "
        "uint32 point_step, uint32 row_step, uint8[] data, bool is_dense"
    ),
    "sensor_msgs/PointField": "string name, uint32 offset, uint8 datatype, uint32 count",
    "sensor_msgs/RegionOfInterest": "uint32 x_offset, uint32 y_offset, uint32 height, uint32 width, bool do_rectify",
    "std_msgs/ColorRGBA": "float32 r, float32 g, float32 b, float32 a",
    "std_msgs/Float64": "float64 data",
    "std_msgs/Header": "builtin_interfaces/Time stamp, string frame_id",
    "std_msgs/String": "string data",
    "tf2_msgs/TFMessage": "geometry_msgs/TransformStamped[] transforms",
    "visualization_msgs/Marker": (
        "std_msgs/Header header, string ns, int32 id, int32 type, int32 action, geometry_msgs/Pose pose, "
        "geometry_msgs/Vector3 scale, std_msgs/ColorRGBA color, builtin_interfaces/Duration lifetime, "
        "bool frame_locked, geometry_msgs/Point[] points, std_msgs/ColorRGBA[] colors, string texture_resource, "
        "sensor_msgs/CompressedImage texture, visualization_msgs/UVCoordinate[] uv_coordinates, string text, "
        "string mesh_resource, visualization_msgs/MeshFile mesh_file, bool mesh_use_embedded_materials"
    ),
    "visualization_msgs/MarkerArray": "visualization_msgs/Marker[] markers",
    "visualization_msgs/MeshFile": "string filename, uint8[] data",
    "visualization_msgs/UVCoordinate": "float32 u, float32 v",
}
"""Name of a message without its `msg` -> its fields, as every version from Humble on has them."""
_RECORDED = (
    "geometry_msgs/WrenchStamped", "rcl_interfaces/Log", "sensor_msgs/CameraInfo", "sensor_msgs/CompressedImage",
    "sensor_msgs/Image", "sensor_msgs/JointState", "sensor_msgs/PointCloud2", "std_msgs/Float64", "std_msgs/String",
    "tf2_msgs/TFMessage", "visualization_msgs/MarkerArray",
)  # fmt: skip


def _text(name: str) -> str:
    """The fields of a message, and those of every message in it."""
    within = [name]
    for part in within:
        kinds = (field.split()[0].split("[")[0] for field in _FIELDS[part].split(", "))
        within += [kind for kind in dict.fromkeys(kinds) if "/" in kind and kind not in within]
    texts = {part: "\n".join(_FIELDS[part].split(", ")) + "\n" for part in within}
    return texts.pop(name) + "".join(f"{'=' * 80}\nMSG: {part}\n{text}" for part, text in texts.items())


DEFINITIONS = {name.replace("/", "/msg/"): _text(name) for name in _RECORDED}
"""Full name of a message -> its fields, and those of the messages in it."""
