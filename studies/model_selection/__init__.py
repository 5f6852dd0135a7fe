"""The selection of effects, of measurement sets and of benches (docs/trace.md). Belongs here: what trials left out say
of a fit, the rules that drop effects, the flexible baseline and the verdict."""
