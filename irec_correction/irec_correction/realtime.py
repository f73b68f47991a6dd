# SPDX-License-Identifier: Apache-2.0
"""What the system permits a loop that must not be late: scheduling, locked memory, frozen garbage. Each said where refused."""

from __future__ import annotations

import ctypes
import gc
import os

MCL_CURRENT, MCL_FUTURE = 1, 2
PR_SET_TIMERSLACK = 29


def prefer_thread(priority: int) -> str:
    """Put the calling thread (and threads it starts from now on) under SCHED_FIFO. Call before importing rclpy.

    Args:
        priority: 1 .. 99; 0 leaves everything as it is.

    Returns:
        empty, or why not and what to do.
    """
    if priority <= 0:
        return ""
    if not hasattr(os, "sched_setscheduler"):
        return "real-time scheduling is not available on this system"
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except (OSError, ValueError) as error:
        return f"SCHED_FIFO {priority} is not permitted ({error}); set 'rtprio' for this user in /etc/security/limits.conf"
    return ""


def prefer_processor(number: int) -> str:
    """Keep the calling thread (and threads it starts from now on) on one processor, best one that the system leaves alone.

    Args:
        number: of the processor, from 0; below 0 leaves everything as it is.

    Returns:
        empty, or why not and what to do.
    """
    if number < 0:
        return ""
    if not hasattr(os, "sched_setaffinity"):
        return "a processor of its own is not available on this system"
    try:
        os.sched_setaffinity(0, {number})
    except (OSError, ValueError) as error:
        return f"processor {number} can't be used ({error}); this process may use {sorted(os.sched_getaffinity(0))}"
    return ""


def settle_memory() -> list[str]:
    """Lock memory, freeze what the garbage collector knows, wake timers punctually. Returns what was not permitted."""
    refused = []
    libc = ctypes.CDLL(None, use_errno=True)
    try:
        if libc.mlockall(MCL_CURRENT | MCL_FUTURE) != 0:
            why = os.strerror(ctypes.get_errno())
            refused.append(f"mlockall is not permitted ({why}); set 'memlock unlimited' in /etc/security/limits.conf")
        libc.prctl(PR_SET_TIMERSLACK, 1, 0, 0, 0)
    except AttributeError as error:
        refused.append(f"memory can't be locked on this system ({error})")
    gc.collect()
    gc.freeze()
    gc.disable()
    return refused
