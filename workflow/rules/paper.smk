# What reproduces the paper: its tables, its figures, and what it leaves open.
PAPER = {
    "Table I": rules.table_1.output,
    "Table II": rules.table_2.output,
    "figure 1": rules.figure_1.output,
    "figure 2": rules.figure_2.output,
    "figure 3": rules.figure_3.output,
    "figure 4": rules.figure_4.output,
    "transfer": rules.transfer.output,
    "limit": expand("results/limit/simulated-{set}.ratios.csv", set=CONTINUOUS_SETS),
}


rule paper:
    """Every table and figure of the paper."""
    input:
        list(PAPER.values()),
