"""A ROS 1 recording, .bag: the messages of the ROS 2 sample, whose headers have a number, too."""

from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from samples import ros

FORMAT = "ros"
STORE = get_typestore(Stores.ROS1_NOETIC)
STORE.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage"))


def converted(value):
    """A message of ROS 2 as one of ROS 1: fields have the same order, and other names."""
    if isinstance(value, list):
        return [converted(one) for one in value]
    if not hasattr(value, "__msgtype__"):
        return value
    fields = [converted(getattr(value, name)) for name in value.__dataclass_fields__ if name != "__msgtype__"]
    return STORE.types[value.__msgtype__](*([0] if value.__msgtype__ == "std_msgs/msg/Header" else []), *fields)


def write(folder):
    with Writer(folder / "walk.bag") as writer:
        known = {}
        for topic, seconds, message in ros.messages():
            kind, one = message.__msgtype__, converted(message)
            if topic not in known:
                known[topic] = writer.add_connection(topic, kind, typestore=STORE)
            writer.write(known[topic], int((ros.START + seconds) * 1e9), STORE.serialize_ros1(one, kind))
    return folder / "walk.bag"
