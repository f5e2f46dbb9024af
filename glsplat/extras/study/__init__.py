"""User studies: a design file, balanced orders, a server for one participant, and tidy tables (docs/study.md).

`serving.lead.StudyLead` is a `Feature` of the server; `glsplat study` checks, plans, runs, exports and analyses.
"""

REQUIRES = ("statistics",)
