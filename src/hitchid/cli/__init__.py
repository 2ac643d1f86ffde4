"""Command line: one module per command, of the same name."""

from hitchid.cli import (
    bench,
    campaign,
    compare,
    design,
    doctor,
    drive,
    export,
    fleet,
    hmi,
    identify,
    inspect,
    reproduce,
    rivals,
    run,
    simulate,
    tune,
    validate,
)
from hitchid.cli.program import app as app
from hitchid.cli.program import main as main

for _command, _example in (
    (inspect.inspect, "hitchid inspect logs/ --draw logs.png"),
    (identify.identify, "hitchid identify logs/ --out model"),
    (validate.validate, "hitchid validate model logs/ --out results"),
    (rivals.rivals, "hitchid rivals model logs/"),
    (compare.compare, "hitchid compare model-a model-b logs/ --out comparison"),
    (simulate.simulate, "hitchid simulate model test.csv --out simulated.csv --bands"),
    (design.design, "hitchid design model --direction lifting --out next-test.csv"),
    (tune.tune, "hitchid tune model --out controller.toml"),
    (drive.drive, "hitchid drive controller.toml --rig nominal --out drive"),
    (export.export, "hitchid export model --to c --out code"),
    (run.run, "recorder | hitchid run model | controller"),
    (campaign.campaign, "hitchid campaign project --source udp:5005 --limits limits.toml"),
    (hmi.hmi, "hitchid hmi project"),
    (bench.bench, "hitchid bench logs --protocol prbs --tests 20"),
    (reproduce.reproduce, "hitchid reproduce --out study --quick"),
    (doctor.doctor, "hitchid doctor --json"),
):
    app.command(epilog=f"Example: {_example}")(_command)
app.add_typer(fleet.app)
