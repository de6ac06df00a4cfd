"""Calls of odak.instruments."""

NOT_CALLED = {"odak.instruments.*": "needs instruments, simulated ones for minutes; they have tests of their own"}
