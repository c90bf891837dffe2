"""The annotation records of Objectron as a message, by the schema in objectron.textproto.

It is built here, so no compiler and no generated code is needed.
"""

from pathlib import Path
from typing import Any

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory, text_format

_schema = Path(__file__).with_name("objectron.textproto").read_text(encoding="utf-8")
# A pool of its own: the published schema, were it loaded too, has the same names in the default one.
_pool = descriptor_pool.DescriptorPool()
_pool.Add(text_format.Parse(_schema, descriptor_pb2.FileDescriptorProto()))

Sequence: Any = message_factory.GetMessageClass(_pool.FindMessageTypeByName("Sequence"))
"""The message of a record file: a video."""
