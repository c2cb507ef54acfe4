"""Sessions are shared by threads, and released."""

import gc
import threading
import weakref

import numpy as np
import pytest

from gsgen.sdk.binding import FrameSession, SessionClosed

BOTH_PROVIDERS = pytest.mark.parametrize("provider", ["cpu", "webgpu"])


@BOTH_PROVIDERS
def test_threads_get_the_frame_that_they_asked_for(provider, models):
    """Two sessions with three threads each: every frame fits the time that was asked for."""
    path, wrong, done = models["drift-float32"], [], []
    with (
        FrameSession(path, provider=provider) as frame_session,
        FrameSession(path, provider=provider) as two,
    ):
        initial, end = (
            frame_session.run({"time": t}, copy=True)["gaussians"][:, :3] for t in (0, 1)
        )

        def work(session, seed):
            for time in np.random.default_rng(seed).random(20):
                actual = session.run({"time": time}, copy=True)["gaussians"][:, :3]
                expected = initial + time * (end - initial)
                done.append(time)
                if np.abs(actual - expected).max() > 1e-5:
                    wrong.append(time)

        threads = [
            threading.Thread(target=work, args=(session, seed))
            for seed, session in enumerate([frame_session, two] * 3)
        ]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    assert (len(done), wrong) == (120, [])


@BOTH_PROVIDERS
def test_a_closed_session_says_so(provider, models):
    session = FrameSession(models["drift-float32"], provider=provider)
    frame, retained = session.run({"time": 0}), session.run({"time": 0}, copy=True)
    assert repr(session).startswith(f"<FrameSession drift-float32.onnx on {provider}, ")
    session.close()
    session.close()
    assert session.closed
    assert repr(session) == f"<FrameSession drift-float32.onnx on {provider}, closed>"
    uses = (
        session.run,
        lambda: session.update({"time": 0}),
        lambda: session.write({}),
        lambda: frame["gaussians"],
        frame.gaussians,
        lambda: session.inputs,
        lambda: session.outputs,
        session.samples,
        session.__enter__,
    )
    for use in uses:
        with pytest.raises(SessionClosed) as raised:
            use()
        assert str(raised.value) == (
            f"{models['drift-float32']}: the session was closed\n  Open a new FrameSession."
        )
    assert len(retained.gaussians()) == 5  # what was copied outlives the session


@BOTH_PROVIDERS
def test_closing_releases_the_session_of_onnx_runtime(provider, models):
    session = FrameSession(models["drift-float32"], provider=provider)
    bound = session._bound
    references = [
        weakref.ref(array) for array in (bound, bound.session, bound.outputs["gaussians"])
    ]
    del bound
    session.close()
    gc.collect()
    assert [entry() for entry in references] == [None] * 3


def test_an_error_inside_the_block_closes_the_session(models):
    with pytest.raises(KeyError), FrameSession(models["drift-float32"], provider="cpu") as session:
        raise KeyError
    assert session.closed
