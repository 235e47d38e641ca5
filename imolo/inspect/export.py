"""Logs as tables: CSV or Parquet, one file per channel, flat named columns with units."""

import csv
import json
import os
from array import array
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from enum import StrEnum
from io import TextIOWrapper
from itertools import islice
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

from imolo.errors import ResultsError
from imolo.inspect.fields import Path as LeafPath
from imolo.inspect.fields import Value, column_name, leaf_name, leaf_unit, leaves
from imolo.inspect.names import Names
from imolo.inspect.plot import log_name
from imolo.inspect.trials import Heard, Timeline, TrialEvents
from imolo.machine.extras import import_extra
from imolo.machine.files import whole_file
from imolo.messaging.channels import CHANNELS
from imolo.messaging.log import decode
from imolo.messaging.log_file import LogReader

RECORDED = "recorded_utime"  # column of the time at which a message was recorded [µs]
TRIAL_IN_LOG = "trial_in_log"  # column of a log of several trials: which of them, from 0
ABOUT = "csv-metadata.json"  # beside CSV files: their columns, as W3C's "Metadata Vocabulary for Tabular Data" has it
CSV_TYPES = {int: "integer", float: "double", str: "string"}
SOURCE = "exported_from.txt"  # beside the tables: the log they were made of
FORMULA = ("=", "+", "-", "@", "\t", "\r", "\n")  # a spreadsheet would take a text that begins so for a formula
BATCH = 10_000  # rows written at once

Rows = Iterator[list[Value | None]]


class Column(NamedTuple):
    """A column: name, type, unit, and what people call it, such as `joint_angle[right_knee]`."""

    name: str
    kind: type
    unit: str
    title: str


class ExportFormat(StrEnum):
    """What a log can be turned into."""

    MCAP = "mcap"
    CSV = "csv"
    PARQUET = "parquet"


def export(log: Path, to: ExportFormat, out: Path | None, trial: int | None = None) -> list[Path]:
    """Write a log in another format and return the files; an earlier export of the same log is replaced.

    Args:
        log: Path of the log.
        to: Which format.
        out: File for MCAP, folder for the tables; beside the log by default.
        trial: Which trial, from 0; None for all of them.

    Raises:
        BusError: The log cannot be read, has no such trial, or holds nothing of ours.
        MissingToolError: The packages of the extra `export` are not installed.
        ResultsError: The files cannot be written, or are there and not an export of this log.
    """
    name = log_name(log) if trial is None else f"{log_name(log)}_trial_{trial}"
    # The name of a file may be any bytes, the text in a file may not.
    source = os.fsencode(log.resolve()).decode(errors="backslashreplace") + (
        f" trial {trial}" if trial is not None else ""
    )
    try:
        if to is ExportFormat.MCAP:
            from imolo.inspect.mcap_export import source_of, write_mcap

            path = out if out is not None else log.with_name(f"{name}.mcap")
            if path.exists():
                _require_same(path, source_of(path), source)
            path.parent.mkdir(parents=True, exist_ok=True)
            with LogReader(log, CHANNELS) as reader, whole_file(path) as file:
                write_mcap(TrialEvents(reader, trial), file, source)
            return [path]
        folder = out if out is not None else log.with_name(f"{name}_{to.value}")
        with LogReader(log, CHANNELS) as reader:
            return _write_tables(TrialEvents(reader, trial), Names.of(log), folder, to, source)
    except OSError as error:
        raise ResultsError(f"cannot write the export of {log}: {error}; choose another --out") from error


def _require_same(path: Path, found: str | None, source: str) -> None:
    if found != source:
        what = "is there and was not exported from a log" if found is None else f"is the export of {found}"
        raise ResultsError(f"{path} {what}; choose another --out, or delete it")


@dataclass
class _Table:
    """One channel: where its messages are, and what its columns are called.

    Attributes:
        places: Trial, time of the recording [µs] and offset in the log of one message after the other.
        longest: Leaves of the message that has most of them; they come first, in the order of the type.
        kinds: Python type of every leaf.
    """

    places: "array[int]" = field(default_factory=lambda: array("q"))
    longest: list[LeafPath] = field(default_factory=list)
    kinds: dict[LeafPath, type] = field(default_factory=dict)

    def add(self, heard: Heard) -> None:
        """Take note of a message."""
        self.places.extend((heard.trial, heard.event.utime, heard.event.offset))
        found = dict(leaves(heard.message))
        if len(found) > len(self.longest):
            self.longest = list(found)
        if not found.keys() <= self.kinds.keys():
            self.kinds |= {path: type(value) for path, value in found.items()}

    @property
    def leaves(self) -> list[LeafPath]:
        """What every message has, in the order of the columns."""
        return list(dict.fromkeys([*self.longest, *self.kinds]))

    def columns(self, channel: str, names: Names, of_session: bool) -> list[Column]:
        """Return the columns in their order."""
        trial = [Column(TRIAL_IN_LOG, int, "", "trial of the log, from 0")] if of_session else []
        recorded = Column(RECORDED, int, "us", "time of the recording")
        return [
            *trial,
            recorded,
            *(
                Column(
                    column_name(leaf),
                    self.kinds[leaf],
                    leaf_unit(channel, leaf, names),
                    leaf_name(channel, leaf, names),
                )
                for leaf in self.leaves
            ),
        ]

    def rows(self, channel: str, reader: LogReader, of_session: bool) -> Rows:
        """Yield the rows; None where a message is shorter than the columns."""
        paths = self.leaves
        for start in range(0, len(self.places), 3):
            trial, recorded, offset = self.places[start : start + 3]
            found = dict(leaves(decode(channel, reader.event(offset).data)))
            yield [*([trial] if of_session else []), recorded, *map(found.get, paths)]


def _write_tables(events: TrialEvents, robot: Names, folder: Path, to: ExportFormat, source: str) -> list[Path]:
    write = _write_csv if to is ExportFormat.CSV else _parquet_writer()
    tables: dict[str, _Table] = {}
    for heard in Timeline(events, CHANNELS):
        tables.setdefault(heard.event.channel, _Table()).add(heard)
    if not tables:
        raise events.nothing()
    names = [name for name in CHANNELS if name in tables]
    files = [folder / f"{name}.{to.value}" for name in names]
    told = folder / SOURCE
    if told.exists() or any(path.exists() for path in files):
        _require_same(folder, told.read_text(encoding="utf-8").strip() if told.exists() else None, source)
    folder.mkdir(parents=True, exist_ok=True)
    of_session = events.count > 1 and events.trial is None
    columns = {name: tables[name].columns(name, robot, of_session) for name in names}
    with ExitStack() as whole:  # all of them take their names together, once the last one is written
        whole.enter_context(whole_file(told)).write(f"{source}\n".encode())
        for name, path in zip(names, files, strict=True):
            rows = tables[name].rows(name, events.reader, of_session)
            write(whole.enter_context(whole_file(path)), columns[name], rows)
        if to is ExportFormat.CSV:
            about = whole.enter_context(whole_file(folder / ABOUT))
            about.write(json.dumps(_about(dict(zip(files, columns.values(), strict=True))), indent=1).encode())
    return files


def _about(tables: Mapping[Path, Sequence[Column]]) -> dict[str, Any]:
    """Return what W3C's metadata say of CSV files; units as schema.org names them."""

    def described(column: Column) -> dict[str, str]:
        unit = {"schema:unitText": column.unit} if column.unit else {}
        return {"name": column.name, "titles": column.name, "dc:description": column.title, **unit} | {
            "datatype": CSV_TYPES[column.kind]
        }

    return {
        "@context": "http://www.w3.org/ns/csvw",
        "tables": [
            {"url": path.name, "tableSchema": {"columns": list(map(described, columns))}}
            for path, columns in tables.items()
        ],
    }


def _write_csv(file: BinaryIO, columns: Sequence[Column], rows: Rows) -> None:
    text = TextIOWrapper(file, encoding="utf-8", newline="")
    writer = csv.writer(text)
    writer.writerow([column.name for column in columns])
    # repr, the default for floats, is the shortest text that reads back as the same number.
    writer.writerows(map(_unlike_formulas, rows))
    text.detach()


def _unlike_formulas(row: list[Value | None]) -> list[Value | None]:
    return [f"'{value}" if isinstance(value, str) and value.startswith(FORMULA) else value for value in row]


def _parquet_writer() -> Callable[[BinaryIO, Sequence[Column], Rows], None]:
    pyarrow, parquet = import_extra("pyarrow", "export"), import_extra("pyarrow.parquet", "export")
    kinds = {int: pyarrow.int64(), float: pyarrow.float64(), str: pyarrow.string()}

    def field(column: Column) -> Any:
        about = {"description": column.title, **({"unit": column.unit} if column.unit else {})}
        return pyarrow.field(column.name, kinds[column.kind], metadata=about)

    def write(file: BinaryIO, columns: Sequence[Column], rows: Rows) -> None:
        schema = pyarrow.schema(list(map(field, columns)))
        with parquet.ParquetWriter(file, schema) as writer:
            while batch := list(islice(rows, BATCH)):
                values = dict(zip(schema.names, zip(*batch, strict=True), strict=True))
                writer.write_table(pyarrow.table(values, schema=schema))

    return write
