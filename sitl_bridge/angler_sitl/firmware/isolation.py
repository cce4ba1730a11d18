"""Network namespace for this process and its children: with loopback alone.

ArduSub takes state packets on a socket that is open on all interfaces, and has no option against
that. In a network namespace there is no other interface. Our sockets have to be in it too, so the
whole program moves there, and no outside process can join: no ground station either.
"""

import fcntl
import os
import socket
import struct
from pathlib import Path

from angler_mjx.errors import UnsupportedError

_SIOCSIFFLAGS = 0x8914
_IFF_UP = 0x1


def isolate_network() -> None:
    """Move this process into its own network namespace, with loopback up. It cannot be undone.

    Root needs no more; other users need a user namespace with it, in which they keep their ids.
    That needs a process of one thread: call it before JAX is loaded.

    Raises:
        UnsupportedError: the kernel or its settings do not allow it.
    """
    uid, gid = os.getuid(), os.getgid()
    try:
        try:
            os.unshare(os.CLONE_NEWNET)
        except PermissionError:
            os.unshare(os.CLONE_NEWUSER | os.CLONE_NEWNET)
            _map_user(uid, gid)
        _enable_loopback()
    except OSError as error:
        raise UnsupportedError(
            f"--isolate: this system gives no network namespace ({error.strerror}); leave it out, "
            "or close the ports listed by angler sitl doctor with a firewall"
        ) from error


def _map_user(uid: int, gid: int) -> None:
    process = Path("/proc/self")
    (process / "uid_map").write_text(f"{uid} {uid} 1")
    # The kernel lets an ordinary user map a group only if the process gives up changing groups.
    (process / "setgroups").write_text("deny")
    (process / "gid_map").write_text(f"{gid} {gid} 1")


def _enable_loopback() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as control:
        fcntl.ioctl(control, _SIOCSIFFLAGS, struct.pack("16sh14x", b"lo", _IFF_UP))
