"""The frame loop and its states, without OpenGL."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from glsplat.errors import ContextError, GlsplatError
from glsplat.extras.openxr.runtime import Event, FrameTiming, Projection, State
from glsplat.extras.openxr.session import Session, Shown
from tests.extras.openxr.fake import FakeRuntime


class Show:
    """Draws nothing, but into images."""

    def __init__(self) -> None:
        self.calls: list[str] = []
        self.fails: BaseException | None = None
        self.focused: list[bool] = []

    def attach(self, runtime: FakeRuntime) -> None:
        self.calls.append("attach")
        self._chain = runtime.swapchain(0x8C43, (8, 8), 2, False)

    def detach(self) -> None:
        self.calls.append("detach")

    def recentred(self) -> None:
        self.calls.append("recentred")

    def frame(self, runtime: FakeRuntime, timing: FrameTiming, focused: bool) -> Shown:
        self.calls.append("frame")
        self.focused.append(focused)
        runtime.devices(timing.display_time, focused)
        views = runtime.views(timing.display_time)
        self._chain.acquire()
        if self.fails is not None:
            self._chain.release()
            raise self.fails
        self._chain.release()
        assert views is not None
        return Shown(Projection(views, [self._chain]), 0.0, 0.0)


class Clock:
    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.now += seconds


def session_of(runtimes: list[FakeRuntime], show: Show, said: list[str] | None = None) -> tuple[Session, Clock]:
    """Each connection takes the next runtime; none left is a runtime that is not there."""
    clock, left = Clock(), list(runtimes)

    def connect() -> FakeRuntime:
        if not left:
            raise ContextError("no OpenXR runtime is active")
        return left.pop(0)

    say: Callable[[str], None] = (said if said is not None else []).append
    return Session(connect, show, say=say, clock=clock, sleep=clock.sleep), clock  # type: ignore[arg-type]


def steps(session: Session, count: int) -> None:
    for _ in range(count):
        assert session.step()


def test_the_order_of_a_session_and_of_its_frames() -> None:
    runtime, show = FakeRuntime(), Show()
    session, _ = session_of([runtime], show)
    steps(session, 3)
    frame = ["wait_frame", "begin_frame", "devices", "views", "acquire", "release", "end_frame"]
    first = ["wait_frame", "begin_frame", "end_frame"]  # the runtime does not want to see the first
    assert runtime.log == ["swapchain", "begin", *first, *frame, *frame]
    assert [projection is None for projection, _ in runtime.shown] == [True, False, False]
    assert (session.frames, session.rendered, session.state) == (3, 2, State.FOCUSED) and session.focused
    assert show.focused == [True, True]
    session.close()
    assert runtime.closed and show.calls[-1] == "detach"


def test_nothing_is_drawn_before_the_session_runs_nor_when_it_stops() -> None:
    runtime, show = FakeRuntime(), Show()
    runtime._events.clear()
    runtime._turn(State.IDLE)
    session, clock = session_of([runtime], show)
    steps(session, 5)
    assert runtime.log == ["swapchain"] and session.state is State.IDLE and clock.now > 0.05
    runtime._turn(State.READY)
    steps(session, 3)
    runtime._turn(State.STOPPING)
    assert not session.step() and session.state is State.EXITING
    assert runtime.log[-1] == "end" and session.frames == 3


def test_input_is_read_only_while_focused_and_invisible_frames_are_ended_all_the_same() -> None:
    runtime, show = FakeRuntime(), Show()
    session, _ = session_of([runtime], show)
    steps(session, 2)
    runtime.tell(Event("state", State.VISIBLE))
    steps(session, 1)
    runtime.tell(Event("state", State.SYNCHRONIZED))
    runtime.should_render = False
    steps(session, 2)
    assert show.focused == [True, False]
    assert [projection is None for projection, _ in runtime.shown] == [True, False, False, True, True]


def test_a_way_out() -> None:
    runtime, show = FakeRuntime(), Show()
    session, _ = session_of([runtime], show)
    steps(session, 4)
    session.quit()
    session.quit()  # more than once is once
    assert [session.step() for _ in range(3)] == [False, False, False]
    assert runtime.log[-2:] == ["request_exit", "end"] and session.state is State.EXITING
    for how in ("does not let go", "is lost"):
        runtime = FakeRuntime()
        session, clock = session_of([runtime], show)
        steps(session, 4)
        session.quit()
        if how == "is lost":
            runtime.kill()
        else:
            runtime._events.clear()
            steps(session, 5)
            clock.now += 10
        assert not session.step(), how


def test_reset_view_counts_from_its_time_on() -> None:
    runtime, show = FakeRuntime(), Show()
    session, _ = session_of([runtime], show)
    steps(session, 3)
    show.calls.clear()
    runtime.recentre()
    steps(session, 3)
    assert show.calls == ["frame", "recentred", "frame", "frame"]


@pytest.mark.parametrize("how", ["killed", "loss pending", "instance loss pending"])
def test_a_runtime_that_goes_and_comes_back(how: str) -> None:
    """The second one cannot blend as the first one did."""
    runtimes = [FakeRuntime(blends=("alpha", "opaque")), FakeRuntime(blends=("additive",))]
    show, said = Show(), []
    session, clock = session_of(runtimes, show, said)
    session.blend = "alpha"
    steps(session, 4)
    if how == "killed":
        runtimes[0].kill()
    else:
        runtimes[0].tell(Event("lost") if how.startswith("instance") else Event("state", State.LOSS_PENDING))
    steps(session, 1)
    assert session.runtime is None and runtimes[0].closed and session.losses == 1
    assert show.calls[-1] == "detach" and len(said) == 1 and "trying again in 0.5 s" in said[0]
    before = session.rendered
    steps(session, 5)
    assert session.runtime is None  # not at once
    clock.now += 1
    steps(session, 10)
    assert session.runtime is runtimes[1] and session.rendered > before and said[-1] == "a fake runtime is back"
    assert [{blend for _, blend in runtime.shown} for runtime in runtimes] == [{"alpha"}, {"additive"}]


def test_it_may_die_in_any_call() -> None:
    for call in ("wait_frame", "begin_frame", "devices", "views", "acquire", "release", "end_frame"):
        runtimes, show = [FakeRuntime(), FakeRuntime()], Show()
        session, clock = session_of(runtimes, show)
        steps(session, 3)
        ask = runtimes[0]._call

        def dies(name: str, *rest: object, call=call, runtime=runtimes[0], ask=ask) -> None:
            if name == call:
                runtime.kill()
            ask(name, *rest)

        runtimes[0]._call = dies  # type: ignore[method-assign]
        steps(session, 1)
        assert session.runtime is None and runtimes[0].closed, call
        clock.now += 1
        steps(session, 4)
        assert session.runtime is runtimes[1] and runtimes[1].shown, call


def test_a_frame_that_was_begun_is_ended_whatever_is_raised_in_it() -> None:
    runtime, show = FakeRuntime(), Show()
    session, _ = session_of([runtime], show)
    steps(session, 3)
    for failure in (GlsplatError("a pose that does not fit"), KeyboardInterrupt()):
        show.fails = failure
        with pytest.raises(type(failure)):
            session.step()
        assert runtime.log[-1] == "end_frame" and runtime.shown[-1][0] is None
    show.fails = None
    steps(session, 2)  # and it goes on


def test_what_cannot_begin_says_so_and_leaves_nothing() -> None:
    with pytest.raises(ContextError, match="no OpenXR runtime"):
        session_of([], Show())
    runtime, show = FakeRuntime(), Show()
    runtime.swapchain = lambda *_: (_ for _ in ()).throw(ContextError("no images"))  # type: ignore[method-assign]
    with pytest.raises(ContextError, match="no images"):
        session_of([runtime], show)
    assert runtime.closed and show.calls == ["attach", "detach"]
