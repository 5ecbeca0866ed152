"""What a simulation leaves out of a recording: where, what, how much."""

import sys

from eitskin.callable_package import CallablePackage

sys.modules[__name__].__class__ = CallablePackage  # for eitskin.diagnose(...)
