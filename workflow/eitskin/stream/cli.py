"""`eitskin stream`."""

import argparse
import signal
import sys
from types import FrameType

from eitskin.errors import named

FAULT = 4
BAUD = 115200


def add(command: argparse.ArgumentParser) -> None:
    """Add the options of `stream` that are no paths."""
    command.add_argument("--fast", action="store_true", help="a recording as fast as it is judged")
    rate = "of a board's port, by default %(default)s"
    command.add_argument("--baud", type=int, default=BAUD, help=rate)


def stream(arguments: argparse.Namespace) -> int:
    """Judge every frame of the source; the exit code."""
    from eitskin.exported import file
    from eitskin.exported.predictor import Predictor
    from eitskin.stream import sources
    from eitskin.stream.judge import Judge
    from eitskin.stream.kept import Keeper
    from eitskin.stream.run import Told, run
    from eitskin.stream.view import View

    exported = file.read(arguments.model)
    predictor, trained_on = Predictor(exported), exported.header["dataset"]
    with named(arguments.model):
        if sources.is_port(arguments.source):
            source = sources.board(arguments.source, arguments.baud, trained_on)
        else:
            source = sources.recorded(arguments.source, trained_on, arguments.fast)
    judge = Judge(predictor, source.difference, source.opening)
    keeper = None
    if arguments.out is not None:
        keeper = Keeper(arguments.out, exported.header, source.difference, source.about)
    view, told, code = View(predictor.targets, arguments.json), Told(), 0
    before = signal.signal(signal.SIGTERM, _interrupt)
    try:
        run(source, judge, view, keeper, told)
    except KeyboardInterrupt:
        pass  # the way to end a board's stream
    except sources.Gone as gone:
        print(gone, file=sys.stderr)
        code = FAULT
    finally:
        signal.signal(signal.SIGTERM, before)
        view.close()
        if keeper is not None:
            keeper.close()
    print(told.sentence(), file=sys.stderr)
    return code


def _interrupt(number: int, frame: FrameType | None) -> None:
    """A SIGTERM ends a stream as Ctrl-C does."""
    raise KeyboardInterrupt
