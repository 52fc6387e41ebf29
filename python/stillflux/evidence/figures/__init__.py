"""The figures of the paper, one a file: scenario, claims, plot, negative control and limits together."""
