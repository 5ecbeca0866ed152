"""`eitskin stream`."""

import argparse
import signal
import sys
from types import FrameType

from eitskin.errors import InputError, named

FAULT = 4
BAUD = 115200


def add(command: argparse.ArgumentParser) -> None:
    """Add the options of `stream` that are no paths."""
    command.add_argument("--fast", action="store_true", help="a recording as fast as it is judged")
    rate = "of a board's port, by default %(default)s"
    command.add_argument("--baud", type=int, default=BAUD, help=rate)


def stream(arguments: argparse.Namespace) -> int:
    """Judge every frame of the source; the exit code."""
    from eitskin.exported import predictor as exported
    from eitskin.stream import sources
    from eitskin.stream.judge import Judge
    from eitskin.stream.kept import Keeper
    from eitskin.stream.run import Told, run
    from eitskin.stream.view import View

    predictor, stop = exported.read(arguments.model), sources.Stop()
    trained_on = predictor.header["dataset"]
    if sources.is_port(arguments.source):
        with named(arguments.model):
            source = sources.board(arguments.source, arguments.baud, trained_on, stop)
    else:
        source = sources.recorded(arguments.source, trained_on, arguments.fast, stop)
    judge = Judge(predictor, source.difference, source.opening)
    keeper = None
    if arguments.out is not None:
        about = predictor.header, source.difference, source.about, arguments.source
        keeper = Keeper(arguments.out, *about)
    view, told, code = View(predictor.targets, arguments.json), Told(), 0

    def ask(number: int, frame: FrameType | None) -> None:
        """A signal ends a stream after the frame that is being judged and written; a second one
        at once, where nobody reads what is printed."""
        if stop.asked:
            raise KeyboardInterrupt
        stop.asked = True

    before = {number: signal.signal(number, ask) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        with named(arguments.source):
            run(source, judge, view, keeper, told)
    except InputError:
        if keeper is not None:
            keeper.discard()
            keeper = None
        raise
    except sources.Gone as gone:
        print(gone, file=sys.stderr)
        code = FAULT
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        view.close()
        if keeper is not None:
            keeper.close()
    print(told.sentence(), file=sys.stderr)
    return code
