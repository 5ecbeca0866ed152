"""A minimal RTDE client, written from Universal Robots' guide to the protocol alone."""

import socket
import struct


class RtdeClient:
    """One connection to a controller's RTDE port."""

    def __init__(self, host: str, port: int = 30004):
        self.socket = socket.create_connection((host, port), timeout=20.0)

    def send(self, command: str, payload: bytes = b"") -> None:
        """One package."""
        self.socket.sendall(struct.pack(">HB", 3 + len(payload), ord(command)) + payload)

    def receive(self) -> tuple[str, bytes]:
        """The next package; ConnectionError where the controller has hung up."""
        size, command = struct.unpack(">HB", self._exactly(3))
        return chr(command), self._exactly(size - 3)

    def ask(self, command: str, payload: bytes = b"") -> bytes:
        """The answer to a package, data packages left out."""
        self.send(command, payload)
        while True:
            answered, data = self.receive()
            if answered == command:
                return data

    def outputs(self, frequency: float, names: str) -> str:
        """The types of outputs."""
        return self.ask("O", struct.pack(">d", frequency) + names.encode())[1:].decode()

    def inputs(self, names: str) -> tuple[int, str]:
        """Recipe and types of inputs."""
        answer = self.ask("I", names.encode())
        return answer[0], answer[1:].decode()

    def close(self) -> None:
        """Hang up."""
        self.socket.close()

    def _exactly(self, size: int) -> bytes:
        data = b""
        while len(data) < size:
            more = self.socket.recv(size - len(data))
            if not more:
                raise ConnectionError("hung up")
            data += more
        return data
