"""The decoder for a channel: ROS 2 CDR, JSON or protobuf. The libraries are loaded when first needed."""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from typing import Any

from ljjax.errors import InputError
from ljjax.logs.container import Container
from ljjax.logs.records import Channel


def decoder(box: Container, channel: Channel) -> Callable[[bytes], Any]:
    """A function from message bytes to an object (or a dict for JSON). Raises InputError; so does the function."""
    place = f"{box.path}: topic {channel.topic}"
    decode = _plain(box, channel, place)

    def checked(data: bytes) -> Any:
        try:
            return decode(data)
        except Exception as error:  # each library raises its own kinds
            raise InputError(
                f"{place}: a message of {len(data)} bytes cannot be decoded as {channel.encoding} "
                f"({type(error).__name__}: {error}); check that the topic's schema is that of its publisher"
            ) from None

    return checked


def _plain(box: Container, channel: Channel, place: str) -> Callable[[bytes], Any]:
    if channel.encoding == "json":
        return json.loads
    schema = box.schemas.get(channel.schema_id)
    if schema is None:
        raise InputError(
            f"{place}: has no schema, so its {channel.encoding} messages cannot be decoded; record it with one"
        )
    if channel.encoding == "cdr" and schema.encoding == "ros2msg":
        from mcap_ros2.decoder import DecoderFactory
    elif channel.encoding == "protobuf" and schema.encoding == "protobuf":
        from mcap_protobuf.decoder import DecoderFactory
    else:
        raise InputError(
            f"{place}: is encoded as {channel.encoding} with a schema in {schema.encoding}; expected cdr with "
            "ros2msg, json, or protobuf; convert the log"
        )
    from mcap.records import Schema

    try:
        with redirect_stdout(StringIO()), redirect_stderr(StringIO()):  # the parsers print what they cannot read
            found = DecoderFactory().decoder_for(
                channel.encoding, Schema(schema.id, schema.data, schema.encoding, schema.name)
            )
    except Exception as error:  # a broken schema fails in many ways
        raise InputError(
            f"{place}: its schema {schema.name} cannot be read ({type(error).__name__}: {error})"
        ) from None
    assert found is not None
    return found
