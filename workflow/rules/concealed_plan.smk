CONCEALED = config["concealed"]
BLOCKS = CONCEALED["blocks"]
PUBLIC, TRUTHS = "results/concealed", "results/truths"


def of_every_case(template):
    """An input function: one file of every case of a block."""

    def files(wildcards):
        names = case_names(BLOCKS[wildcards.block]["cases"])
        return expand(template, block=wildcards.block, case=names)

    return files
