"""The annotation records of Objectron as protocol buffers: the published fields that are read, by number and type.

The messages are built here, so no compiler and no generated code is needed; fields that are not listed are skipped
when a record is read. Published schema: annotation_data.proto, object.proto and a_r_capture_metadata.proto
(Ahmadyan et al. 2020). Packages and names are the published ones, so records written here are read by its tools.

    Sequence            a video: its objects in the world, and what was annotated in each frame
    Object              rotation (9, row by row), translation (3) and scale (3): object to world, metres
    FrameAnnotation     a frame: its number, the objects seen in it, the camera
    ObjectAnnotation    an object in a frame: nine keypoints (the box's centre, then its corners), how much is visible
    AnnotatedKeyPoint   a point in the camera's frame (metres) and in the image as shown ((0, 0) upper left, (1, 1))
    ARCamera            row by row: transform (camera to world) and view_matrix (world to camera), projection_matrix
"""

from __future__ import annotations

from typing import Any

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

_Field = descriptor_pb2.FieldDescriptorProto
_TYPES = {"int32": _Field.TYPE_INT32, "float": _Field.TYPE_FLOAT, "double": _Field.TYPE_DOUBLE}

_CAPTURE = "research.compvideo.arcapture"
_PURSUIT = "xeno.pursuit.proto"

# Message -> field -> number and type; a star marks fields that are repeated.
_CAMERA = {
    "ARCamera": {
        "transform": (3, "float*"),
        "image_resolution_width": (5, "int32"),
        "image_resolution_height": (6, "int32"),
        "intrinsics": (7, "float*"),
        "projection_matrix": (8, "float*"),
        "view_matrix": (9, "float*"),
    }
}
_OBJECT = {
    "Object": {"id": (1, "int32"), "rotation": (4, "float*"), "translation": (5, "float*"), "scale": (6, "float*")}
}
_ANNOTATION = {
    "NormalizedPoint2D": {"x": (1, "float"), "y": (2, "float"), "depth": (3, "float")},
    "Point3D": {"x": (1, "float"), "y": (2, "float"), "z": (3, "float")},
    "AnnotatedKeyPoint": {
        "id": (1, "int32"),
        "point_3d": (2, f"{_PURSUIT}.Point3D"),
        "point_2d": (3, f"{_PURSUIT}.NormalizedPoint2D"),
    },
    "ObjectAnnotation": {
        "object_id": (1, "int32"),
        "keypoints": (2, f"{_PURSUIT}.AnnotatedKeyPoint*"),
        "visibility": (3, "float"),
    },
    "FrameAnnotation": {
        "frame_id": (1, "int32"),
        "annotations": (2, f"{_PURSUIT}.ObjectAnnotation*"),
        "camera": (3, f"{_CAPTURE}.ARCamera"),
        "timestamp": (4, "double"),
    },
    "Sequence": {"objects": (1, f"{_PURSUIT}.Object*"), "frame_annotations": (2, f"{_PURSUIT}.FrameAnnotation*")},
}


def _add(
    pool: Any, name: str, package: str, syntax: str, messages: dict[str, dict[str, tuple[int, str]]], *needs: str
) -> None:
    file = descriptor_pb2.FileDescriptorProto(name=name, package=package, syntax=syntax, dependency=needs)
    for title, fields in messages.items():
        message = file.message_type.add(name=title)
        for field, (number, kind) in fields.items():
            plain = kind.rstrip("*")
            repeated = kind.endswith("*")
            item = message.field.add(
                name=field, number=number, label=_Field.LABEL_REPEATED if repeated else _Field.LABEL_OPTIONAL
            )
            if plain in _TYPES:
                item.type = _TYPES[plain]
                if repeated:
                    item.options.packed = True
            else:
                item.type, item.type_name = _Field.TYPE_MESSAGE, f".{plain}"
    pool.AddSerializedFile(file.SerializeToString())


def _sequence() -> Any:
    # A pool of its own: the published schema, were it loaded too, has the same names in the default one.
    pool = descriptor_pool.DescriptorPool()
    _add(pool, "a_r_capture_metadata.proto", _CAPTURE, "proto2", _CAMERA)
    _add(pool, "object.proto", _PURSUIT, "proto3", _OBJECT)
    needs = ("a_r_capture_metadata.proto", "object.proto")
    _add(pool, "annotation_data.proto", _PURSUIT, "proto3", _ANNOTATION, *needs)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(f"{_PURSUIT}.Sequence"))


Sequence: Any = _sequence()
"""The message of a record file."""
