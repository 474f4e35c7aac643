#!/usr/bin/env python3
"""serial_port.py SOCKET LINK: a pseudo-terminal, linked at LINK, joined to serve.mjs's socket (a port number or a Unix path).

A host program opens LINK as it would /dev/ttyACM0. No modem lines: DTR is up as long as this runs. Ends with the socket or on
SIGTERM, and takes the link away.
"""

import os
import pty
import select
import signal
import socket
import sys
import tty


def main(where: str, link: str) -> None:
    if where.isdigit():
        sock = socket.create_connection(("127.0.0.1", int(where)))
    else:
        sock = socket.socket(socket.AF_UNIX)
        sock.connect(where)
    # the slave end stays open here, so that the master does not fail between two openings by the host program
    master, slave = pty.openpty()
    tty.setraw(slave)
    if os.path.islink(link):
        os.unlink(link)
    os.symlink(os.ttyname(slave), link)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    try:
        while True:
            for ready in select.select([master, sock], [], [])[0]:
                if ready is master:
                    sock.sendall(os.read(master, 4096))
                    continue
                data = sock.recv(4096)
                if not data:
                    return
                while data:
                    data = data[os.write(master, data) :]
    finally:
        os.unlink(link)


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    main(sys.argv[1], sys.argv[2])
