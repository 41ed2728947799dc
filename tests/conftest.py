"""What holds for all tests."""

import signal


def pytest_configure() -> None:
    """Undo that a shell starts what runs in its background with interrupts ignored: some tests send them."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
