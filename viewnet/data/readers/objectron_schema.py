"""The annotation records of Objectron as protocol buffers: the published fields that are read, by number and type.

Built here, so no compiler and no generated code is needed; other fields are skipped. Names are those of
annotation_data.proto, object.proto and a_r_capture_metadata.proto (Ahmadyan et al. 2020), whose tools
read what is written.

    Sequence            a video: its objects in the world, and the annotations of each frame
    Object              rotation (9, row by row), translation (3) and scale (3): object to world, metres
    FrameAnnotation     a frame: its number, the objects in it, the camera
    ObjectAnnotation    an object in a frame: nine keypoints (the box's centre, then its corners), its visible share
    AnnotatedKeyPoint   a point in the camera's frame (metres) and in the image as shown ((0, 0) upper left, (1, 1))
    ARCamera            row by row: transform (camera to world) and view_matrix (world to camera), projection_matrix
"""

from typing import Any

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

_Field = descriptor_pb2.FieldDescriptorProto
_TYPES = {"int32": _Field.TYPE_INT32, "float": _Field.TYPE_FLOAT, "double": _Field.TYPE_DOUBLE}

# Message -> fields as "number type name"; a star marks fields that are repeated.
_MESSAGES: dict[str, tuple[str, ...]] = {
    "ARCamera": (
        "3 float* transform", "5 int32 image_resolution_width", "6 int32 image_resolution_height",
        "7 float* intrinsics", "8 float* projection_matrix", "9 float* view_matrix",
    ),
    "Object": ("1 int32 id", "4 float* rotation", "5 float* translation", "6 float* scale"),
    "NormalizedPoint2D": ("1 float x", "2 float y", "3 float depth"),
    "Point3D": ("1 float x", "2 float y", "3 float z"),
    "AnnotatedKeyPoint": ("1 int32 id", "2 Point3D point_3d", "3 NormalizedPoint2D point_2d"),
    "ObjectAnnotation": ("1 int32 object_id", "2 AnnotatedKeyPoint* keypoints", "3 float visibility"),
    "FrameAnnotation": (
        "1 int32 frame_id", "2 ObjectAnnotation* annotations", "3 ARCamera camera", "4 double timestamp",
    ),
    "Sequence": ("1 Object* objects", "2 FrameAnnotation* frame_annotations"),
}  # fmt: skip


def _sequence() -> Any:
    file = descriptor_pb2.FileDescriptorProto(name="objectron.proto", syntax="proto3")
    for title, fields in _MESSAGES.items():
        message = file.message_type.add(name=title)
        for field in fields:
            number, kind, label = field.split()
            item = message.field.add(name=label, number=int(number))
            item.label = _Field.LABEL_REPEATED if kind.endswith("*") else _Field.LABEL_OPTIONAL
            if (plain := kind.rstrip("*")) in _TYPES:
                item.type = _TYPES[plain]
            else:
                item.type_name = f".{plain}"
    # A pool of its own: the published schema, were it loaded too, has the same names in the default one.
    pool = descriptor_pool.DescriptorPool()
    pool.AddSerializedFile(file.SerializeToString())
    return message_factory.GetMessageClass(pool.FindMessageTypeByName("Sequence"))


Sequence: Any = _sequence()
"""The message of a record file."""
