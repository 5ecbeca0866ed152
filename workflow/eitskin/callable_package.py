"""Packages that are called like the function of their name: `eitskin.diagnose` is both."""

from importlib import import_module
from types import ModuleType
from typing import Any


class CallablePackage(ModuleType):
    """A package eitskin.NAME that, called, is the function NAME of `eitskin.scripting`."""

    def __call__(self, *arguments: Any, **options: Any) -> Any:
        """The result of that function, of these arguments."""
        function = self.__name__.rpartition(".")[2]
        return getattr(import_module("eitskin.scripting"), function)(*arguments, **options)
