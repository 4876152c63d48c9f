"""Labels that stay closed until the diagnosis has spoken; only their hash is published."""

from __future__ import annotations

import hashlib
import json
import os
import secrets
from pathlib import Path
from typing import Any

HASH = "label.sha256"


def close(label: dict[str, Any], sealed: Path, public: Path) -> None:
    """Write the label with a random number to the file `sealed` and the hash of that file into the folder `public`."""
    data = json.dumps({"label": label, "nonce": secrets.token_hex(32)}, indent=1, sort_keys=True).encode()
    part = sealed.with_suffix(".part")
    part.write_bytes(data)
    os.replace(part, sealed)
    (public / HASH).write_text(hashlib.sha256(data).hexdigest() + "\n", encoding="utf-8")


def opened(sealed: Path, public: Path, answer: Path) -> dict[str, Any]:
    """The label. Raises PermissionError before `answer` is there, ValueError where the hash does not hold."""
    if not answer.exists():
        raise PermissionError(f"{sealed}: stays closed until {answer} is written")
    data = sealed.read_bytes()
    if hashlib.sha256(data).hexdigest() != (public / HASH).read_text(encoding="utf-8").strip():
        raise ValueError(f"{sealed}: its hash is not the one published in {public / HASH}")
    return json.loads(data)["label"]
