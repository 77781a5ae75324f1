"""What is queued is done where all goes well, and not begun once something went wrong."""

from threading import Event, Timer

import pytest

from pcbench.machine.pools import pool


def test_what_is_asked_for_is_done():
    with pool(2) as threads:
        assert [f.result() for f in [threads.submit(abs, -i) for i in range(5)]] == list(range(5))


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt])
def test_after_an_error_nothing_more_is_begun(error):
    begun, go = [], Event()

    def work(i):
        begun.append(i)
        go.wait(10)

    def stopped():
        with pool(1) as threads:
            for i in range(5):
                threads.submit(work, i)
            Timer(0.2, go.set).start()  # what has begun ends by itself, once the others are taken back
            raise error

    with pytest.raises(error):
        stopped()
    assert begun == [0]
