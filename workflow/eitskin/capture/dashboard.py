"""The robot's dashboard server: what it says of itself, and a second way to stop it."""

import contextlib
import socket
import threading

PORT = 29999
TIMEOUT_S = 2.0


class Dashboard:
    """One connection, opened when it is first needed and anew when it was lost."""

    def __init__(self, host: str):
        self._host = host
        self._socket: socket.socket | None = None
        self._rest = b""
        self._lock = threading.Lock()

    def ask(self, command: str) -> str:
        """The one line that answers `command`; raises OSError where none comes in time."""
        with self._lock:
            if self._socket is not None:
                with contextlib.suppress(OSError):
                    return self._exchange(self._socket, command)
                self._close(self._socket)
            opened = socket.create_connection((self._host, PORT), timeout=TIMEOUT_S)
            self._socket = opened
            try:
                self._line(opened)  # the greeting
                return self._exchange(opened, command)
            except OSError:
                self._close(opened)
                raise

    def _exchange(self, opened: socket.socket, command: str) -> str:
        opened.sendall(command.encode() + b"\n")
        return self._line(opened)

    def _line(self, opened: socket.socket) -> str:
        while b"\n" not in self._rest:
            chunk = opened.recv(4096)
            if not chunk:
                raise ConnectionError("the dashboard closed the connection")
            self._rest += chunk
        line, _, self._rest = self._rest.partition(b"\n")
        return line.decode(errors="replace").strip()

    def _close(self, opened: socket.socket) -> None:
        opened.close()
        self._socket, self._rest = None, b""

    def close(self) -> None:
        """Close the connection."""
        with self._lock:
            if self._socket is not None:
                self._close(self._socket)
