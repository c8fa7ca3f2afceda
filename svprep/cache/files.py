"""Replacing a file whole: exclusive lock, temporary sibling, sync, rename.

    .NAME.lock                 held (flock) by the one writer, removed by it
    .NAME.tmp-PID-RANDOM       what it writes; renamed over NAME at the end

A writer that is killed leaves both behind, unlocked; the next writer takes the
lock over and removes the temporary.
"""

from __future__ import annotations

import contextlib
import errno
import os
import re
import secrets
import stat
import time
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType

from svprep.errors import CacheError, EnvironmentProblem
from svprep.interrupts import interrupts_held_back

try:
    import fcntl
except ImportError:  # Windows: no lock, on best effort
    fcntl = None  # type: ignore[assignment]

HDF5_SIGNATURE = b"\x89HDF\r\n\x1a\n"
LOCK_POLL_S = 0.05
_LARGE_BYTES = 1 << 18
"""What is written at once and brought to the disk while more is written."""
_PIECE_BYTES = 1 << 20
"""For more, Linux takes large pages, which are slow where `use_small_pages` says: 5 ms for two of
these, else 0.4 ms."""


def problem_of(error: OSError, target: Path, option: str = "-o") -> EnvironmentProblem:
    """Return the one line that says why `target`, named by `option`, could not be written."""
    reason = os.strerror(error.errno) if error.errno else " ".join(str(error).split())
    elsewhere = f"Choose another place with {option}"
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        what = f"the disk is full ({reason}). Free some space or choose another place with {option}"
    elif error.errno == errno.EFBIG:
        what = f"the file size limit is too small ({reason}). Raise it: ulimit -f unlimited"
    elif error.errno in (errno.ENOENT, errno.ENOTDIR):
        what = _folder_problem(target.parent, option)
    elif error.errno in (errno.EACCES, errno.EPERM, errno.EROFS):
        what = f'no files can be made in the folder "{target.parent}" ({reason}). {elsewhere}'
    elif error.errno == errno.ENAMETOOLONG:
        what = f"the name is too long. Choose a shorter one with {option}"
    else:
        what = f"{reason}. {elsewhere}"
    return EnvironmentProblem(f"{target} cannot be written: {what}. Nothing was changed.")


def _folder_problem(folder: Path, option: str) -> str:
    """Return why a file in `folder` could not be made, when the system says "no such file"."""
    if folder.is_dir():
        return f'the folder "{folder}" takes no new files. Choose another place with {option}'
    for parent in (*reversed(folder.parents), folder):
        if parent.exists() and not parent.is_dir():
            return f'"{parent}" is a file, not a folder. Choose another place with {option}'
    return f'there is no folder "{folder}". Create it or choose another with {option}'


def resolve_target(path: str | os.PathLike[str]) -> Path:
    """Return the file that `path` names, symbolic links followed, if it may be replaced.

    Also tries whether its folder takes new files: better told before a long
    build than after. Pass the text that the user gave: a `Path` has lost the
    slash at the end that names a folder.

    Raises
    ------
    CacheError
        It exists and is not a regular file, names a folder, or holds something
        else than a cache: a slip of ``-o`` must not overwrite a model.
    EnvironmentProblem
        Its folder is missing, or takes no new files.
    """
    given = os.fspath(path)
    target = Path(os.path.realpath(given))
    try:
        # realpath drops a slash at the end: "sub/" would make a file "sub".
        names_folder = os.path.basename(given) in ("", os.curdir, os.pardir)
        mode = target.stat().st_mode if target.exists() else 0
        if names_folder or stat.S_ISDIR(mode):
            raise CacheError(
                f'"{given}" names a folder. Name a file with -o, such as '
                f"{os.path.join(given, 'NAME.svp.h5')}"
            )
        if mode and not stat.S_ISREG(mode):
            raise CacheError(f"{target} is not a regular file. Choose another place with -o")
        head = b""
        if mode:
            with target.open("rb") as file:
                head = file.read(len(HDF5_SIGNATURE))
        if head and (head != HDF5_SIGNATURE or _is_foreign(target)):
            raise CacheError(
                f"{target} exists and is not a cache of svprep, so it is not "
                "overwritten. Choose another name with -o, or remove it first"
            )
        with interrupts_held_back(), Temporary(target):
            pass
    except OSError as error:
        raise problem_of(error, target) from error
    return target


def _is_foreign(target: Path) -> bool:
    """Whether an HDF5 file is not ours: without our magic, or unreadable and not so named."""
    import h5py

    from svprep.cache.schema import MAGIC

    try:
        with h5py.File(target, "r", locking=False) as file:
            magic = file.attrs.get("magic")
    except (OSError, RuntimeError, ValueError, KeyError):
        return not target.name.endswith(".svp.h5")  # a damaged cache may be built again
    return magic != MAGIC and magic != MAGIC.encode()


@contextlib.contextmanager
def exclusive_lock(target: Path, wait_s: float = 0.0) -> Iterator[None]:
    """Hold the right to replace `target`; the lock file is gone afterwards.

    The holder removes the lock file before it lets go. Whoever opened it
    earlier and gets the lock then finds that the name no longer leads to its
    file, and starts again: two writers never hold locks on different files of
    one name.

    Raises
    ------
    CacheError
        Another process holds it, for longer than `wait_s`.
    EnvironmentProblem
        The folder cannot be written.
    """
    lock_path = target.with_name(f".{target.name}.lock")
    deadline = time.monotonic() + wait_s
    fd = None
    try:
        try:
            with interrupts_held_back() as interrupt:
                while (fd := _try_lock(lock_path)) is None:
                    if time.monotonic() >= deadline:
                        raise CacheError(
                            f"{target}: {_holder(lock_path)} is writing it. Wait for it to end, or "
                            "write to another name"
                        )
                    time.sleep(LOCK_POLL_S)
                    interrupt()
        except OSError as error:
            raise problem_of(error, target) from error
        # For the message to others only: on a full disk the lock holds without it.
        with contextlib.suppress(OSError):
            os.ftruncate(fd, 0)
            os.pwrite(fd, f"{os.getpid()}\n".encode(), 0)
        yield
    finally:
        if fd is not None:
            with interrupts_held_back():
                with contextlib.suppress(OSError):
                    lock_path.unlink()
                os.close(fd)


def _try_lock(lock_path: Path) -> int | None:
    """Return the locked file's descriptor, or None where another process holds it."""
    while True:
        fd = os.open(lock_path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
        try:
            if fcntl is not None:
                fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
            held, named = os.fstat(fd), os.stat(lock_path)
        except BlockingIOError:
            os.close(fd)
            return None
        except FileNotFoundError:
            os.close(fd)
            continue
        except BaseException:
            os.close(fd)
            raise
        if (held.st_dev, held.st_ino) != (named.st_dev, named.st_ino):
            os.close(fd)
            continue
        return fd


def _holder(lock_path: Path) -> str:
    try:
        return f"process {int(lock_path.read_text())}"
    except (OSError, ValueError):
        return "another process"


def remove_leftovers(target: Path) -> None:
    """Remove the temporaries of dead writers. Only the holder of the lock may call this."""
    leftover = re.compile(re.escape(f".{target.name}.tmp-") + r"\d+-[0-9a-f]+")
    with os.scandir(target.parent) as entries:
        for entry in entries:
            if leftover.fullmatch(entry.name):
                Path(entry.path).unlink(missing_ok=True)


class Temporary:
    """A new sibling of `target` that HDF5 writes through; removed unless renamed.

    HDF5 that meets a failing write (full disk) keeps the file open for ever
    and may crash at exit. So it writes through this object, which takes every
    byte without complaint, remembers the first error, and raises it from
    `check`, once HDF5 has let go.
    """

    def __init__(self, target: Path) -> None:
        self.target = target
        name = f".{target.name}.tmp-{os.getpid()}-{secrets.token_hex(4)}"
        self.path = target.with_name(name)
        self._fd = os.open(self.path, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o666)
        self._at = 0
        self._error: BaseException | None = None

    def __enter__(self) -> Temporary:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        os.close(self._fd)
        self.path.unlink(missing_ok=True)

    def check(self) -> None:
        """Raise the first error that a write met."""
        if self._error is not None:
            raise self._error

    def sync(self) -> None:
        """Force the bytes to the disk."""
        self.check()
        os.fsync(self._fd)

    def rename(self) -> int:
        """Rename the file over `target`; return its size."""
        self.check()
        n_bytes = os.fstat(self._fd).st_size
        os.replace(self.path, self.target)
        return n_bytes

    # From here on: what h5py's file-object driver calls.

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Move to `offset`; return the place."""
        base = {os.SEEK_SET: 0, os.SEEK_CUR: self._at}.get(whence)
        self._at = offset + (os.fstat(self._fd).st_size if base is None else base)
        return self._at

    def tell(self) -> int:
        """Return the place."""
        return self._at

    def read(self, size: int = -1) -> bytes:
        """Return `size` bytes from the place on."""
        data = os.pread(self._fd, size if size >= 0 else os.fstat(self._fd).st_size, self._at)
        self._at += len(data)
        return data

    def readinto(self, buffer: memoryview) -> int:
        """Fill `buffer`; return how many bytes there were."""
        data = self.read(len(buffer))
        buffer[: len(data)] = data
        return len(data)

    def write(self, buffer: memoryview) -> int:
        """Take every byte; a failure is kept for `check`."""
        view = memoryview(buffer).cast("B")
        self.write_at(self._at, view)
        self._at += len(view)
        return len(view)

    def write_at(self, offset: int, buffer: memoryview) -> None:
        """Write every byte at `offset`; a failure is kept for `check`. Threads may call this."""
        done = 0
        try:
            while done < len(buffer) and self._error is None:
                piece = buffer[done : done + _PIECE_BYTES]
                done += os.pwrite(self._fd, piece, offset + done)
            if self._error is None and len(buffer) >= _LARGE_BYTES:
                _write_out(self._fd, offset, len(buffer))
        except BaseException as error:  # KeyboardInterrupt, too: raised by `check`
            self._error = error

    def truncate(self, size: int | None = None) -> int:
        """Set the size; a failure is kept for `check`."""
        size = self._at if size is None else size
        try:
            if self._error is None:
                os.ftruncate(self._fd, size)
        except BaseException as error:
            self._error = error
        return size

    def flush(self) -> None:
        """Nothing is buffered here; `sync` is what reaches the disk."""


def _write_out(fd: int, offset: int, n_bytes: int) -> None:
    """Have the system begin to bring bytes to the disk, for which `Temporary.sync` waits."""
    if hasattr(os, "posix_fadvise"):
        with contextlib.suppress(OSError):  # a file system without it: nothing is lost
            os.posix_fadvise(fd, offset, n_bytes, os.POSIX_FADV_DONTNEED)


def sync_folder(folder: Path) -> None:
    """Force a rename in `folder` to the disk, where the file system can."""
    fd = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(fd)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.ENOTSUP, errno.EBADF):
            raise
    finally:
        os.close(fd)
