"""The command line: parse, call, show."""

from hitchid.cli.benching import bench, reproduce
from hitchid.cli.identifying import identify
from hitchid.cli.judging import compare, validate
from hitchid.cli.logs import inspect
from hitchid.cli.program import app as app
from hitchid.cli.program import main as main
from hitchid.cli.using import design, run, simulate

app.command(epilog="Example: hitchid inspect logs/ --draw logs.png")(inspect)
app.command(epilog="Example: hitchid identify logs/ --out model")(identify)
app.command(epilog="Example: hitchid validate model logs/ --out results")(validate)
app.command(epilog="Example: hitchid compare model-a model-b logs/ --out comparison")(compare)
app.command(epilog="Example: hitchid simulate model test.csv --out simulated.csv --bands")(simulate)
app.command(epilog="Example: hitchid design model --direction lifting --out next-test.csv")(design)
app.command(epilog="Example: recorder | hitchid run model | controller")(run)
app.command(epilog="Example: hitchid bench logs --protocol prbs --tests 20")(bench)
app.command(epilog="Example: hitchid reproduce --out study --quick")(reproduce)
