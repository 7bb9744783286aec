"""The production line: events in as they come, one record a part out.

Data flow: `recording.live` puts events in order, the scheduler of `evqr.stream` reads them, `history` keeps
what was seen lately, `gates` say of which times each trigger asks, `parts` makes one record a part of both,
`reader` joins them.
"""
