"""A function in a file of a user's."""

from __future__ import annotations

import ast
import importlib.util
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from torch_mcaa.errors import McaaError


def load_function(place: str) -> Callable[..., Any]:
    """The function of `file.py:name`.

    Raises:
        McaaError: no such file, not Python, no such name in it, or not a function; the message names what there is.
    """
    path, _, name = place.rpartition(":")
    if not path or not name:
        raise McaaError(f"a scene is written file.py:function or as an image file, got {place!r}")
    file = Path(path)
    if not file.is_file():
        raise McaaError(f"there is no file {path!r}; a scene is written file.py:function")
    try:
        # as bytes, for the file may name its encoding
        tree = ast.parse(file.read_bytes(), filename=path)
    except (OSError, SyntaxError, ValueError) as error:
        raise McaaError(f"{path} cannot be read as Python: {error}") from error
    spec = importlib.util.spec_from_file_location("mcaa_scene", file)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    # as for a program: dataclasses look their module up, and f may import its neighbours when it is called
    sys.modules[spec.name] = module
    folder, known = file.parent.resolve(), set(sys.modules)
    sys.path.insert(0, str(folder))
    try:
        spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:
        raise McaaError(f"{path} raised {type(error).__name__} when it was loaded: {error}") from error
    for other in set(sys.modules) - known:
        # a scene of another folder may have a neighbour of the same name
        top, origin = other.partition(".")[0], Path(getattr(sys.modules[other], "__file__", None) or "/")
        if origin == folder / f"{top}.py" or folder / top in origin.parents:
            del sys.modules[other]
    if not hasattr(module, name):
        functions = [node.name for node in tree.body if isinstance(node, ast.FunctionDef)]
        raise McaaError(f"{path} has no {name!r}; it has {', '.join(functions) if functions else 'no functions'}")
    f = getattr(module, name)
    if not callable(f):
        raise McaaError(f"{name!r} in {path} is {type(f).__name__}, not a function of x and y")
    return f
