"""The robot's dashboard server: its identity and mode, and a second way to stop it."""

import contextlib
import socket
import threading

PORT = 29999  # Universal Robots, "Dashboard Server"
TIMEOUT_S = 2.0  # for one line over a local network


class Dashboard:
    """One connection, opened by the first command and again after it was lost."""

    def __init__(self, host: str):
        self._host = host
        self._socket: socket.socket | None = None
        self._buffer = b""
        self._lock = threading.Lock()

    def ask(self, command: str) -> str:
        """The line that answers `command`; raises OSError where none comes in time."""
        with self._lock:
            if self._socket is not None:
                with contextlib.suppress(OSError):
                    return self._exchange(self._socket, command)
                self._close(self._socket)
            connection = socket.create_connection((self._host, PORT), timeout=TIMEOUT_S)
            self._socket = connection
            try:
                self._line(connection)  # the greeting
                return self._exchange(connection, command)
            except OSError:
                self._close(connection)
                raise

    def _exchange(self, connection: socket.socket, command: str) -> str:
        connection.sendall(command.encode() + b"\n")
        return self._line(connection)

    def _line(self, connection: socket.socket) -> str:
        while b"\n" not in self._buffer:
            chunk = connection.recv(4096)
            if not chunk:
                raise ConnectionError("the dashboard closed the connection")
            self._buffer += chunk
        line, _, self._buffer = self._buffer.partition(b"\n")
        return line.decode(errors="replace").strip()

    def _close(self, connection: socket.socket) -> None:
        connection.close()
        self._socket, self._buffer = None, b""

    def close(self) -> None:
        """Close the connection."""
        with self._lock:
            if self._socket is not None:
                self._close(self._socket)
