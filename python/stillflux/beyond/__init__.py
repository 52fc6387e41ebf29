"""Beyond the paper: the whole torque-speed plane and what can go wrong in it, for any scheme.

`scenarios` builds the runs, `judge` measures one on the plant's truth, `targets` says what each must show,
`runner` runs them in processes, `draw` and `page` make pictures, tables and the section of the report.
"""
