"""Files of a cache: whole or absent, and read only where their checksum is right.

Several processes may write one file at once: the last one stays. A folder that cannot be read or
written is an empty cache.
"""

import hashlib
from pathlib import Path
from tempfile import NamedTemporaryFile

_CHECKSUM_BYTES = hashlib.sha256().digest_size


def read_checked(path: Path) -> bytes | None:
    """Return the content that `write_checked` wrote; None for an absent or a damaged file."""
    try:
        content = path.read_bytes()
    except OSError:
        return None
    checksum, payload = content[:_CHECKSUM_BYTES], content[_CHECKSUM_BYTES:]
    return payload if hashlib.sha256(payload).digest() == checksum else None


def write_checked(path: Path, payload: bytes) -> bool:
    """Write a file whole or not at all, with its folder; return whether it was written."""
    temporary = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with NamedTemporaryFile(dir=path.parent, delete=False) as file:
            temporary = Path(file.name)
            file.write(hashlib.sha256(payload).digest() + payload)
        temporary.replace(path)
    except OSError:  # a full disk, or a folder of somebody else
        if temporary is not None:
            temporary.unlink(missing_ok=True)
        return False
    return True
