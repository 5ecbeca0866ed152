"""When a recording tells two names apart: SNR gaps between them."""

CONFUSED = 3.0  # a gap under which two names are one class
WEAK = 5.0  # a gap under which they are told apart weakly
