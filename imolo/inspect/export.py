"""Logs as tables: CSV or Parquet, one file per channel, flat named columns."""

import csv
from collections.abc import Callable
from enum import StrEnum
from pathlib import Path

from imolo.errors import ResultsError
from imolo.inspect.fields import Value, columns
from imolo.machine.extras import import_extra
from imolo.messaging.log import Log

RECORDED = "recorded_utime"  # column of the time at which a message was recorded [µs]
Columns = dict[str, list[Value | None]]


class ExportFormat(StrEnum):
    """What a log can be turned into."""

    MCAP = "mcap"
    CSV = "csv"
    PARQUET = "parquet"


def export(log: Log, to: ExportFormat, out: Path | None) -> list[Path]:
    """Write a log in another format and return the files.

    Args:
        log: The log.
        to: Which format.
        out: File for MCAP, folder for the tables; beside the log by default.

    Raises:
        MissingToolError: The packages of the extra `export` are not installed.
        ResultsError: The files cannot be written.
    """
    try:
        if to is ExportFormat.MCAP:
            from imolo.inspect.mcap_export import write_mcap

            path = out if out is not None else log.path.with_suffix(".mcap")
            path.parent.mkdir(parents=True, exist_ok=True)
            write_mcap(log, path)
            return [path]
        write = _write_csv if to is ExportFormat.CSV else _parquet_writer()
        folder = out if out is not None else log.path.with_name(f"{log.path.stem}_{to.value}")
        folder.mkdir(parents=True, exist_ok=True)
        return [
            _write_table(log, name, folder / f"{name}.{to.value}", write) for name in log.messages if log.messages[name]
        ]
    except OSError as error:
        raise ResultsError(f"cannot write the export of {log.path}: {error}; choose another --out") from error


def _write_table(log: Log, name: str, path: Path, write: Callable[[Path, Columns], None]) -> Path:
    write(path, {RECORDED: list(log.received[name]), **columns(log.messages[name])})
    return path


def _write_csv(path: Path, table: Columns) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(table)
        # repr, the default for floats, is the shortest text that reads back as the same number.
        writer.writerows(zip(*table.values(), strict=True))


def _parquet_writer() -> Callable[[Path, Columns], None]:
    pyarrow, parquet = import_extra("pyarrow", "export"), import_extra("pyarrow.parquet", "export")

    def write(path: Path, table: Columns) -> None:
        parquet.write_table(pyarrow.table(table), str(path))

    return write
