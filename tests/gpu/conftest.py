"""One OpenGL context for all tests here; without one they are skipped, each by its name.

Where the environment variable CI is set, no OpenGL is a failure.
"""

from __future__ import annotations

import os
from collections.abc import Iterator

import pytest

from svprep.errors import EnvironmentProblem
from svprep_runtime.context import Context, headless
from tests.gpu.scenes import Stage

_reason: list[str] = []
_unrun: list[str] = []


@pytest.fixture(scope="session")
def one_context() -> Iterator[Context | str]:
    """The context, or why there is none."""
    manager = headless()
    try:
        context = manager.__enter__()
    except EnvironmentProblem as error:
        _reason.append(str(error))
        yield str(error)
        return
    yield context
    manager.__exit__(None, None, None)


@pytest.fixture
def context(one_context: Context | str, request: pytest.FixtureRequest) -> Iterator[Context]:
    """The context, current; tests of a window may have made another one so."""
    if isinstance(one_context, str):
        _unrun.append(request.node.nodeid)
        if os.environ.get("CI"):
            pytest.fail(f"CI needs OpenGL: {one_context}", pytrace=False)
        pytest.skip(f"no OpenGL: {one_context}")
    with one_context.ctx:
        yield one_context


@pytest.fixture(scope="session")
def one_stage(one_context: Context | str) -> Iterator[Stage | None]:
    if isinstance(one_context, str):
        yield None
        return
    made = Stage(one_context)
    yield made
    with one_context.ctx:
        made.release()


@pytest.fixture
def stage(context: Context, one_stage: Stage) -> Stage:
    """Scenes and targets that tests share, since every program takes long to compile."""
    return one_stage


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Name what was not tested: a dot more or less is easily overlooked."""
    if not _unrun:
        return
    terminalreporter.section("NOT TESTED: no OpenGL", sep="!", red=True)
    terminalreporter.line(_reason[0])
    for name in _unrun:
        terminalreporter.line(f"not tested: {name}")
