"""Log lines of long-running commands, as text or as JSON, one a line, with UTC time stamps."""

from __future__ import annotations

import json
import logging
from datetime import UTC, datetime

FORMATS = ("text", "json")


def start_logging(kind: str, level: int) -> None:
    """Send log records of at least ``level``, and Python's warnings, to standard error; ``kind`` is one of FORMATS."""
    handler = logging.StreamHandler()
    handler.setFormatter(_Json() if kind == "json" else _Text())
    logging.basicConfig(level=level, handlers=[handler], force=True)
    logging.captureWarnings(True)


def _stamp(record: logging.LogRecord) -> str:
    """Return the time in UTC, ISO 8601 with milliseconds, such as 2026-11-21T09:30:00.125Z."""
    return datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


class _Text(logging.Formatter):
    """``TIME LEVEL LOGGER: MESSAGE``; a traceback follows on lines of its own."""

    def format(self, record: logging.LogRecord) -> str:
        """Return the lines of a record."""
        # text of a client must not start a line of its own, or control the terminal
        message = "".join(c if c.isprintable() else repr(c)[1:-1] for c in record.getMessage())
        line = f"{_stamp(record)} {record.levelname} {record.name}: {message}"
        return f"{line}\n{self.formatException(record.exc_info)}" if record.exc_info else line


class _Json(logging.Formatter):
    """One JSON object a line: time, level, logger, message, and the traceback where there is one."""

    def format(self, record: logging.LogRecord) -> str:
        """Return the line of a record; JSON escapes line ends and control characters."""
        fields = {
            "time": _stamp(record),
            "level": record.levelname.lower(),
            "logger": record.name,
            "message": record.getMessage(),
        }
        if record.exc_info:
            fields["traceback"] = self.formatException(record.exc_info)
        return json.dumps(fields)
