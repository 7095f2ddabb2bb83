"""Exact re-run: makes the recorded calls into a component again and compares what it publishes.

`call_logs` finds the calls in a recording, `engine` makes them, `comparison` compares messages,
`files` provides the files that the component had read, `worker` does all that in a process of its
own, and `excerpt` writes what one component needs as a recording and a test.
"""
