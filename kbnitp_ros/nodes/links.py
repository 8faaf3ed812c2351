# SPDX-License-Identifier: Apache-2.0
"""The links of this computer to others, of which DDS takes note only when a node starts."""

from __future__ import annotations

from fcntl import ioctl
import socket
import struct

# From linux/sockios.h and linux/if.h.
SIOCGIFFLAGS, SIOCGIFADDR = 0x8913, 0x8915
IFF_LOOPBACK, IFF_RUNNING = 0x8, 0x40

# A `struct ifreq` begins with a name; flags, or the family and port of an address, follow.
REQUEST, FLAGS, ADDRESS = struct.Struct('16s24x'), struct.Struct('16xH'), struct.Struct('20x4s')


def addresses() -> dict[str, str]:
    """Return the IPv4 address of each interface that has a link, by name; that of lo is none."""
    found = {}
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asked:
        for _, name in socket.if_nameindex():
            request = REQUEST.pack(name.encode())
            try:
                (flags,) = FLAGS.unpack_from(ioctl(asked, SIOCGIFFLAGS, request))
                (address,) = ADDRESS.unpack_from(ioctl(asked, SIOCGIFADDR, request))
            except OSError:
                # It has no address, or is gone.
                continue
            if flags & IFF_RUNNING and not flags & IFF_LOOPBACK:
                found[name] = socket.inet_ntoa(address)
    return found


class Links:
    """What DDS knows of the links of this computer; to be made before the node."""

    # A node that starts without a link listens on lo alone, and stays deaf when one comes up. One
    # whose address changes is not found under the new one.

    def __init__(self) -> None:
        self._known = addresses()

    @property
    def are_missing(self) -> bool:
        """Whether there was none when the node started."""
        return not self._known

    @property
    def news(self) -> str:
        """Return which addresses there are that DDS does not know; empty if it knows all."""
        new = addresses().items() - self._known.items()
        return ', '.join(f'{name} has {address}' for name, address in sorted(new))
