"""Default runs over measured data and a zoo of made-up campaigns, against committed bars.

    python -m benchmarks.gauntlet                     # what CI runs: eight sets, 4 + 60 campaigns
    python -m benchmarks.gauntlet --full              # all sixty by default identify
    python -m benchmarks.gauntlet --zoo 7 --physics   # campaign 7 of the zoo, no training, no comparison
    python -m benchmarks.gauntlet --zoo 7 --keep DIR  # its logs stay in DIR
    python -m benchmarks.gauntlet --set rig-a         # one measured set
    python -m benchmarks.gauntlet --seed 3405691582   # those that a failed run has named

From the root of the repository, with `HITCHID_DATA` as the tests take it. Single runs print what they found
and write no page. The exit code is 1 where something failed or missed its bar.
"""
