"""The nouns of the program: a design with its fabric and muscles, pressures, trials and benches, a fitted model,
and the forward model in which simulator, corrector and search meet. Belongs here: a noun that several rooms use,
as a frozen dataclass or a protocol; how a file holds it is said in `files`.
"""
