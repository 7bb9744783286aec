"""The settings of a service, as its file has them, and the file itself."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from os import PathLike
from typing import Annotated, Any

from evqr.config import JobConfig, ReadConfig, TriggerConfig
from evqr.config.settings import Count, Positive, Range, Settings
from evqr.errors import UsageError
from evqr.sinks.outlet import WhenFull

Port = Annotated[int, Range(least=0, most=65535)]


class Keep(str, Enum):
    """Of which parts a flight recorder keeps the events."""

    NO_READ = "no_read"
    ALL = "all"


class TriggerSource(str, Enum):
    """Where triggers come from."""

    NONE = "none"
    STREAM = "stream"


@dataclass(frozen=True, kw_only=True)
class SourceSettings(Settings):
    """Where events come from.

    Attributes
    ----------
    where : str
        A recording, which is played, ``tcp://HOST:PORT``, ``unix:PATH``, ``-`` for standard input,
        ``camera``, ``camera:SERIAL``, or ``dv://HOST:PORT``.
    speed : float, optional
        Of a recording: time of it over time. Default: as fast as it is read.
    repeat : bool
        Play a recording again and again. Chosen: once.
    sensor : str, optional
        Size, as 640x480, of a recording that does not tell. Default: as it tells.
    """

    where: str = ""
    speed: Positive | None = None
    repeat: bool = False
    sensor: str | None = None


@dataclass(frozen=True, kw_only=True)
class OutletSettings(Settings):
    """What all places where records go have in common.

    Attributes
    ----------
    spool : str, optional
        A file for records that wait, which outlives the program. Default: they wait in memory.
    spool_bytes : int
        Room in it. Chosen.
    room : int
        Records that may wait in memory. Chosen.
    when_full : WhenFull
        Whether the line waits where there is no room, or the record is left out. Chosen: it is left out.
    """

    spool: str | None = None
    spool_bytes: Count = 1 << 30
    room: Count = 10_000
    when_full: WhenFull = WhenFull.DROP


@dataclass(frozen=True, kw_only=True)
class JsonLinesSettings(OutletSettings):
    """A file of JSON lines.

    Attributes
    ----------
    path : str
        The file.
    """

    path: str = ""


@dataclass(frozen=True, kw_only=True)
class DatabaseSettings(OutletSettings):
    """A SQLite file.

    Attributes
    ----------
    path : str
        The file.
    keep_days : float, optional [d]
        Older rows go. Default: none do.
    keep_rows : int, optional
        The oldest rows beyond so many go. Default: none do.
    """

    path: str = ""
    keep_days: Positive | None = None
    keep_rows: Count | None = None


@dataclass(frozen=True, kw_only=True)
class TcpSettings(OutletSettings):
    """A TCP server that sends lines of text.

    Attributes
    ----------
    host : str
        Where to listen. Chosen: this machine alone.
    port : int
        Where to listen. Chosen.
    line : str
        What a record becomes, with its keys in braces. Chosen.
    no_read : str
        What ``{text}`` is where nothing was read. Chosen.
    kinds : tuple of str
        Kinds of records that are sent. Chosen: parts.
    needs_client : bool
        Records wait until somebody is connected. Chosen: they do not.
    """

    host: str = "127.0.0.1"
    port: Port = 9000
    line: str = "{part};{text}"
    no_read: str = "NOREAD"
    kinds: tuple[str, ...] = ("part",)
    needs_client: bool = False


@dataclass(frozen=True, kw_only=True)
class MqttSettings(OutletSettings):
    """An MQTT broker.

    Attributes
    ----------
    host : str
        The broker.
    port : int
        Of the broker. Chosen: the usual one.
    topic : str
        Where to, with keys of records in braces. Chosen.
    user, password : str, optional
        Of an account there. Default: none.
    tls : bool
        Encrypted. Chosen: not.
    """

    host: str = ""
    port: Port = 1883
    topic: str = "evqr/{line}/{camera}/{record}"
    user: str | None = None
    password: str | None = None
    tls: bool = False


@dataclass(frozen=True, kw_only=True)
class WebhookSettings(OutletSettings):
    """A web address that takes records by POST.

    Attributes
    ----------
    url : str
        The address.
    bearer : str, optional
        A token, sent as ``Authorization: Bearer``. Default: none.
    """

    url: str = ""
    bearer: str | None = None


@dataclass(frozen=True, kw_only=True)
class OpcUaSettings(OutletSettings):
    """An OPC UA server.

    Attributes
    ----------
    endpoint : str
        Where to serve. Chosen: this machine alone.
    """

    endpoint: str = "opc.tcp://127.0.0.1:4840/evqr"


@dataclass(frozen=True, kw_only=True)
class RecorderSettings(Settings):
    """The flight recorder.

    Attributes
    ----------
    folder : str, optional
        Where files go. Default: nothing is kept.
    seconds : float [s]
        How long events are kept in memory. Chosen.
    quota_bytes : int
        Of all files. Chosen.
    keep : Keep
        Of which parts. Chosen: of those that were not read.
    """

    folder: str | None = None
    seconds: Positive = 10.0
    quota_bytes: Count = 1 << 30
    keep: Keep = Keep.NO_READ


@dataclass(frozen=True, kw_only=True)
class PageSettings(Settings):
    """The page, with metrics and health.

    Attributes
    ----------
    enabled : bool
        Whether there is one. Chosen: not.
    host : str
        Where to listen. Chosen: this machine alone.
    port : int
        Where to listen. Chosen.
    token : str, optional
        What who asks must have; needed where other machines can ask. Default: none.
    """

    enabled: bool = False
    host: str = "127.0.0.1"
    port: Port = 8080
    token: str | None = None


@dataclass(frozen=True, kw_only=True)
class WatchSettings(Settings):
    """What the service looks after.

    Attributes
    ----------
    heartbeat_s : float [s]
        Time between two records "heartbeat". Chosen.
    least_read_rate : float, optional
        Below it there is an alarm. Default: there is none.
    alarm_parts : int
        The last parts that the rate is of; with fewer there is no alarm. Chosen.
    self_check : str, optional
        A recording of a part that can be read; read at the start, and if it cannot be, the line is not ready.
        Default: none.
    sequence_file : str, optional
        Where the number of the next record is kept, so that they go on over a restart. Default: they begin
        at 0.
    """

    heartbeat_s: Positive = 10.0
    least_read_rate: Annotated[float, Range(above=0.0, most=1.0)] | None = None
    alarm_parts: Count = 100
    self_check: str | None = None
    sequence_file: str | None = None


@dataclass(frozen=True, kw_only=True)
class ServiceSettings(Settings):
    """All of a service.

    Attributes
    ----------
    line, camera : str
        Names that records carry. Default: none.
    backend : str
        What runs the kernels. Chosen: what there is.
    device : str
        Where to compute. Chosen.
    source : SourceSettings
        Where events come from.
    triggers : TriggerSource
        Where triggers come from; none: each code that passes is a part.
    trigger : TriggerConfig
        What triggers ask for.
    read : ReadConfig
        How codes are read.
    job : str
        The job in use, of the tables ``jobs``. Default: none.
    json_lines, database, tcp, mqtt, webhook, opcua : tuples of settings
        Where records go; each any number of times.
    recorder : RecorderSettings
        The flight recorder.
    page : PageSettings
        The page.
    watch : WatchSettings
        Heartbeat, alarm, self-check.
    """

    line: str = ""
    camera: str = ""
    backend: str = "auto"
    device: str = "cpu"
    source: SourceSettings = field(default_factory=SourceSettings)
    triggers: TriggerSource = TriggerSource.NONE
    trigger: TriggerConfig = field(default_factory=TriggerConfig)
    read: ReadConfig = field(default_factory=ReadConfig)
    job: str = ""
    json_lines: tuple[JsonLinesSettings, ...] = ()
    database: tuple[DatabaseSettings, ...] = ()
    tcp: tuple[TcpSettings, ...] = ()
    mqtt: tuple[MqttSettings, ...] = ()
    webhook: tuple[WebhookSettings, ...] = ()
    opcua: tuple[OpcUaSettings, ...] = ()
    recorder: RecorderSettings = field(default_factory=RecorderSettings)
    page: PageSettings = field(default_factory=PageSettings)
    watch: WatchSettings = field(default_factory=WatchSettings)


def _complete(settings: ServiceSettings, jobs: Mapping[str, JobConfig]) -> None:
    """Refuse settings of which something without a default is missing."""
    if not settings.source.where:
        raise ValueError("source.where must say where events come from")
    needed = (("json_lines", "path"), ("database", "path"), ("mqtt", "host"), ("webhook", "url"))
    for name, key in needed:
        if not all(getattr(each, key) for each in getattr(settings, name)):
            raise ValueError(f"{name}.{key} is needed")
    if settings.job and settings.job not in jobs:
        raise ValueError(f"job must be one of {', '.join(jobs) or 'none'}, got {settings.job!r}")


def load_settings(path: str | PathLike[str]) -> tuple[ServiceSettings, dict[str, JobConfig]]:
    """Read a file of settings, in TOML.

    Parameters
    ----------
    path : path
        The file: tables as of `ServiceSettings`, and ``jobs.NAME`` as of `JobConfig`.

    Returns
    -------
    settings, jobs : ServiceSettings, dict
        All of them; jobs by name.

    Raises
    ------
    UsageError
        The file cannot be read, or says what makes no sense: which, and what is allowed.
    """
    try:
        with open(path, "rb") as file:
            text = file.read().decode("utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise UsageError(f"{path}: cannot be read ({reason}); check the path") from error
    return parse_settings(text, str(path))


def parse_settings(text: str, name: str) -> tuple[ServiceSettings, dict[str, JobConfig]]:
    """Read settings from text, as `load_settings` does from a file.

    Parameters
    ----------
    text : str
        TOML.
    name : str
        What messages call it.

    Returns
    -------
    settings, jobs : ServiceSettings, dict
        All of them; jobs by name.

    Raises
    ------
    UsageError
        It is no TOML, or says what makes no sense.
    """
    toml = _toml()
    try:
        values: dict[str, Any] = toml.loads(text)
    except toml.TOMLDecodeError as error:
        raise UsageError(f"{name}: is no TOML: {' '.join(str(error).split())}") from error
    tables = values.pop("jobs", {})
    try:
        if not isinstance(tables, Mapping) or not all(isinstance(each, Mapping) for each in tables.values()):
            raise TypeError("jobs must be tables, as [jobs.NAME]")
        jobs = {job: JobConfig.from_dict(table) for job, table in tables.items()}
        settings = ServiceSettings.from_dict(values)
        _complete(settings, jobs)
    except (TypeError, ValueError) as error:
        raise UsageError(f"{name}: {error}") from error
    return settings, jobs


def _toml() -> Any:
    """Give the parser: Python's own from 3.11 on, before that the package it comes from."""
    try:
        import tomllib  # novm  (3.10 has the package below)
    except ImportError:
        from evqr.extras import needs_extra

        with needs_extra("a file of settings on Python 3.10", "tomli", "line"):
            import tomli as tomllib  # pyright: ignore[reportMissingImports]  # not there from 3.11 on
    return tomllib
