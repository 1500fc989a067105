"""The folder of a chart: files that are whole or not there, and a chart that goes on where it was interrupted."""

from __future__ import annotations

import csv
import dataclasses
import io
import json
import os
import secrets
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from torch_mcaa.charting.fit import Cell, Point
from torch_mcaa.charting.truth import Truth
from torch_mcaa.errors import McaaError

RESULTS = "results.json"
DRAWN = ("results.csv", "chart.svg", "chart.png", "chart.html")


class Store:
    """What has been measured under some settings.

    Attributes:
        folder: where it is kept; made with the first thing that is written.
        cells: by (scene, method, budget, seed).
        truths: by scene.
    """

    def __init__(self, folder: Path, settings: dict[str, Any], force: bool) -> None:
        """Look at the folder, and take up a chart of equal settings.

        Raises:
            McaaError: a folder that cannot be written; another chart or files of the chart's names in it, without `force`.
        """
        self.folder = folder
        self.settings = settings
        self.cells: dict[tuple[str, str, int, int], Cell] = {}
        self.truths: dict[str, Truth] = {}
        # what was drawn of another chart goes with its first cell
        self._outdated = not self._found(force)

    def _found(self, force: bool) -> bool:
        """Whether there is a chart of equal settings, whose cells are then taken up."""
        place = self.folder
        while not place.exists() and place != place.parent:
            place = place.parent
        if not place.is_dir() or not os.access(place, os.W_OK | os.X_OK):
            why = "not a folder" if not place.is_dir() else "Permission denied"
            raise McaaError(f"the folder {self.folder} cannot be written: {place}: {why}; name another")
        file = self.folder / RESULTS
        mend = "name another folder, or --force / force=True to write over it"
        if not file.exists():
            there = [name for name in DRAWN if (self.folder / name).exists()]
            if there and not force:
                raise McaaError(f"{self.folder} has {', '.join(there)} and no {RESULTS}; {mend}")
            return False
        try:
            held = json.loads(file.read_text(encoding="utf-8"))
            before = held["settings"]
            cells = [Cell(**cell) for cell in held["cells"]]
        except (OSError, ValueError, KeyError, TypeError) as error:
            if force:
                return False
            raise McaaError(f"{file} cannot be read as a chart: {error}; {mend}") from error
        if before != self.settings:
            if force:
                return False
            keys = [key for key in {**before, **self.settings} if before.get(key) != self.settings.get(key)]
            shown = "; ".join(f"{key} was {before.get(key)!r}, now {self.settings.get(key)!r}"[:160] for key in keys)
            raise McaaError(f"{self.folder} holds another chart ({shown}); {mend}")
        self.cells = {(cell.scene, cell.method, cell.budget, cell.seed): cell for cell in cells}
        return True

    def add(self, cell: Cell) -> None:
        """Keep a cell, at once."""
        self.cells[cell.scene, cell.method, cell.budget, cell.seed] = cell
        self.write_results([], complete=False)
        if self._outdated:
            for name in DRAWN:
                (self.folder / name).unlink(missing_ok=True)
            self._outdated = False

    def truth(self, scene: str, digest: str) -> Truth | None:
        """A truth that was kept, if it is of these settings."""
        try:
            with np.load(self._truth_file(scene)) as held:
                if str(held["key"]) != self._key(digest):
                    return None
                return Truth(torch.from_numpy(held["value"]), torch.from_numpy(held["error"]), str(held["kind"]), str(held["how"]))
        except (OSError, ValueError, KeyError):
            return None

    def keep_truth(self, scene: str, digest: str, truth: Truth) -> None:
        buffer = io.BytesIO()
        arrays: dict[str, Any] = {"value": truth.value.numpy(), "error": truth.error.numpy()}
        np.savez_compressed(buffer, **arrays, kind=truth.kind, how=truth.how, key=self._key(digest))
        self.write(self._truth_file(scene).relative_to(self.folder), buffer.getvalue())

    def picture_file(self, scene: str, method: str, budget: int, kind: str) -> Path:
        """Of a picture or map of the page, relative to the folder."""
        return Path("measured") / plain(scene) / f"{plain(method)}-{budget}-{kind}.png"

    def write_results(self, points: Sequence[Point], complete: bool) -> None:
        """results.json, and results.csv with the points."""
        truths = {
            scene: {
                "kind": truth.kind,
                "how": truth.how,
                "error": truth.typical,
                "range": truth.span,
                "pixels": int(truth.busy.sum()),
            }
            for scene, truth in self.truths.items()
        }
        held = {
            "settings": self.settings,
            "complete": complete,
            "truths": truths,
            "summary": [dataclasses.asdict(point) for point in points],
            "cells": [dataclasses.asdict(cell) for cell in self.cells.values()],
        }
        self.write(Path(RESULTS), json.dumps(held, indent=1, ensure_ascii=False).encode())
        if not complete:
            return
        names = [field.name for field in dataclasses.fields(Point)]
        text = io.StringIO()
        lines = csv.writer(text, lineterminator="\n")
        lines.writerow(names)
        lines.writerows([_short(getattr(point, name)) for name in names] for point in points)
        self.write(Path("results.csv"), text.getvalue().encode())

    def write(self, name: Path, content: bytes) -> None:
        """A file of the folder, by a rename once it is whole.

        Raises:
            McaaError: what the disk refuses; what lay there stays.
        """
        target = self.folder / name
        temporary = target.with_name(f".{secrets.token_hex(8)}.tmp")
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
            try:
                with open(temporary, "xb") as file:
                    file.write(content)
                    file.flush()
                    os.fsync(file.fileno())
                os.replace(temporary, target)
            finally:
                temporary.unlink(missing_ok=True)
        except OSError as error:
            raise McaaError(f"cannot write {target}: {error.strerror}; nothing there was changed; name another folder") from error

    def _truth_file(self, scene: str) -> Path:
        return self.folder / "measured" / plain(scene) / "truth.npz"

    def _key(self, digest: str) -> str:
        return json.dumps([digest, *(self.settings[key] for key in ("size", "filter", "extent", "budgets", "torch_mcaa"))])


def plain(name: str) -> str:
    """A name as part of a file's name."""
    return "".join(c if c.isalnum() else "-" for c in name.lower()).strip("-") or "f"


def _short(value: object) -> object:
    return "" if value is None else f"{value:.4g}" if isinstance(value, float) else value
