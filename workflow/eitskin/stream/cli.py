"""`eitskin stream`."""

import argparse
import signal
import sys
from types import FrameType

import numpy as np

from eitskin.errors import InputError, named
from eitskin.quantities import plain

FAULT = 4  # exit code, as of a capture's fault


def add(command: argparse.ArgumentParser) -> None:
    """Add the options of `stream` that are no paths."""
    command.add_argument("--fast", action="store_true", help="a recording as fast as it is judged")
    description = "a page on this machine that draws the stream, by default at any free port"
    command.add_argument("--view", type=int, nargs="?", const=0, metavar="PORT", help=description)
    description = "the board: its name or its YAML file, by default the known one of the channels"
    command.add_argument("--board", help=description)
    command.add_argument("--baud", type=int, help="of a board's port, where it is not the board's")


def stream(arguments: argparse.Namespace) -> int:
    """Judge every frame of the source; the exit code."""
    from eitskin.exported import predictor as exported
    from eitskin.stream import sources
    from eitskin.stream.judge import Judge
    from eitskin.stream.page import PageView
    from eitskin.stream.recorder import Recorder
    from eitskin.stream.run import Tally, run
    from eitskin.stream.view import View

    predictor, stop = exported.read(arguments.model), sources.Stop()
    trained_on = predictor.header["dataset"]
    if sources.is_device(arguments.source):
        with named(arguments.model):
            source = sources.board_source(
                arguments.source, arguments.board, arguments.baud, trained_on, stop
            )
    else:
        source = sources.recording_source(arguments.source, trained_on, arguments.fast, stop)
    judge = Judge(predictor, source.is_difference, source.n_opening_frames)
    lines = View(predictor.targets, arguments.json, stop=stop)
    view: View | PageView = lines
    if arguments.view is not None:
        channels, skin = np.array(trained_on["channels"]), predictor.header["skin"]
        described = predictor.targets, channels, skin, arguments.source, arguments.view
        view = PageView(lines, *described)
        print(f"view: {view.address}", file=sys.stderr, flush=True)
    recorder = None
    if arguments.out is not None:
        description = predictor.header, source.is_difference, source.description, arguments.source
        recorder = Recorder(arguments.out, *description)
    tally, exit_code = Tally(), 0

    def request_stop(number: int, frame: FrameType | None) -> None:
        """End the stream after the present frame; at a second signal at once."""
        if stop.is_requested:
            raise KeyboardInterrupt
        stop.is_requested = True

    previous_handlers = {
        number: signal.signal(number, request_stop) for number in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        with named(arguments.source):
            run(source, judge, view, recorder, tally)
    except InputError:
        if recorder is not None:
            recorder.discard()
            recorder = None
        raise
    except sources.PortLost as error:
        print(plain(str(error)), file=sys.stderr)
        exit_code = FAULT
    finally:
        for number, handler in previous_handlers.items():
            signal.signal(number, handler)
        view.close()
        if recorder is not None:
            recorder.close()
    print(tally.sentence(), file=sys.stderr)
    return exit_code
