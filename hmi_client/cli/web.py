"""`hmi-client web`: the operator's page in a browser."""

from pathlib import Path
from typing import Annotated

import typer

from fleetpose.hmi_client.cli import connection as c
from fleetpose.hmi_client.cli.options import KeysFile, LogFile, OpenBrowser, Threshold
from fleetpose.protocol.commands import examples

app = typer.Typer()


@app.command(epilog=examples("hmi-client web --connect tcp/192.168.1.10:7447"))
def web(
    listen: Annotated[
        str, typer.Option(help="where pages are served, HOST:PORT")
    ] = "127.0.0.1:8642",
    open_browser: OpenBrowser = True,
    replay: Annotated[
        Path | None, typer.Option(help="show a recorded session; needs no server")
    ] = None,
    token_file: Annotated[
        Path | None,
        typer.Option(help="lines 'kim:TOKEN': who has the token clicks as kim; mode 600"),
    ] = None,
    certificate: Annotated[Path | None, typer.Option(help="for https: chain, PEM")] = None,
    key: Annotated[Path | None, typer.Option(help="for https: private key, PEM")] = None,
    name: Annotated[
        list[str] | None,
        typer.Option(help="another name under which pages reach this machine, repeatable"),
    ] = None,
    threshold: Threshold = None,
    keys: KeysFile = None,
    log: LogFile = None,
    connect: c.Connect = c.DEFAULT_CONNECT,
    site: c.Site = c.DEFAULT_SITE,
    config: c.Config = None,
    operator: c.Operator = "",
) -> None:
    """Serves the screen as a page for a browser, and prints its address; Ctrl-C ends it.

    Only this machine reaches it. Through SSH: ssh -L 8642:127.0.0.1:8642 MACHINE, then open the
    printed address here. Other addresses need --token-file, --certificate and --key.
    """
    from fleetpose.hmi_client.local_files import default_log, keymap_of, own_log
    from fleetpose.hmi_client.web.gate import Address
    from fleetpose.hmi_client.web.serve import Reach, run_web

    where = c.Connection.of(connect, site, config, operator)
    reach = Reach(Address.of(listen), token_file, certificate, key, tuple(name or ()), open_browser)
    reach.check()
    own_log(log or default_log())
    run_web(where, reach, keymap_of(keys), threshold, replay, typer.echo)
