"""What several test files share."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
import torch


@pytest.fixture(scope="module", autouse=True)
def one_thread() -> Iterator[None]:
    """Pictures in tests are small: threads that wait for each other on a busy machine cost three times the work.

    That the number of threads changes no bit is tested elsewhere.
    """
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(autouse=True)
def same_numbers() -> None:
    """A test draws the same numbers wherever, and after whatever, it runs."""
    torch.manual_seed(0)
