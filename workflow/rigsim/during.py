"""`python -m rigsim.during CONFIG.yaml COMMAND …`: a command while the emulated rig lives.

The command finds the emulator listening, and has standard input, output and the terminal's Ctrl-C.
SIGTERM is passed on to it: the emulator lives until the arm is lifted and the command has ended.
Exit code: the command's; where that is 0 the emulator's: 3 where the driver broke a rule.
"""

import argparse
import shutil
import signal
import subprocess
import sys

ENDING_S = 60.0  # for the arm to be lifted, far longer than any press takes


def main() -> int:
    """Run both; returns the exit code."""
    parser = argparse.ArgumentParser(prog="rigsim.during", description=__doc__.splitlines()[0])
    parser.add_argument("config", help="the emulated rig's YAML file")
    parser.add_argument("command", nargs=argparse.REMAINDER, help="what is run meanwhile")
    arguments = parser.parse_args()
    if not arguments.command or shutil.which(arguments.command[0]) is None:
        parser.error(f"no command {' '.join(arguments.command[:1])!r}, expected one to run")
    with subprocess.Popen(
        [sys.executable, "-m", "rigsim", arguments.config],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        start_new_session=True,  # Ctrl-C is the command's: the arm is still to be lifted
    ) as emulator:
        assert emulator.stdin is not None and emulator.stdout is not None
        if not emulator.stdout.readline():
            return emulator.wait()
        early_signals: list[int] = []
        signal.signal(signal.SIGTERM, lambda number, _frame: early_signals.append(number))
        with subprocess.Popen(arguments.command) as command:
            signal.signal(signal.SIGINT, signal.SIG_IGN)
            signal.signal(signal.SIGTERM, lambda number, _frame: command.send_signal(number))
            for number in early_signals:
                command.send_signal(number)
            code = command.wait()
        emulator.stdin.close()
        try:
            emulator_code = emulator.wait(ENDING_S)
        except subprocess.TimeoutExpired:
            emulator.kill()
            emulator_code = emulator.wait()
    if emulator_code:
        print(f"the emulated rig ended with {emulator_code}", file=sys.stderr)
    return code or emulator_code


if __name__ == "__main__":
    sys.exit(main())
