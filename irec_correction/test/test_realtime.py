# SPDX-License-Identifier: Apache-2.0
"""What the system refuses is said, with the reason; nothing is raised."""

from __future__ import annotations

import os

import pytest
from irec_correction.realtime import prefer_processor


@pytest.fixture
def processors():
    allowed = os.sched_getaffinity(0)
    yield allowed
    os.sched_setaffinity(0, allowed)


def test_the_thread_stays_on_the_processor_that_was_named(processors):
    number = max(processors)
    assert prefer_processor(number) == ""
    assert os.sched_getaffinity(0) == {number}


def test_no_processor_leaves_everything_as_it_is(processors):
    assert prefer_processor(-1) == ""
    assert os.sched_getaffinity(0) == processors


@pytest.mark.parametrize("number", [100_000, 4000])
def test_a_processor_that_is_not_there_is_named(processors, number):
    assert str(number) in prefer_processor(number)
    assert os.sched_getaffinity(0) == processors
