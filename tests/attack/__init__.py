"""The attack suite, `make attack`: hostile input that Cairn must refuse in bounded time and memory.

| file | attacker | input |
|---|---|---|
| test_files.py | supplier of files | YAML, images, recordings, maps: bombs, devices, damage |
| test_requests.py | peer without rights | malformed, huge and forbidden requests, floods |
| test_peers.py | peer without rights | forged, replayed, invalid messages; ghosts, floods |
| test_roles.py | user on the network | all that the roles `view` and `operate` do not allow |
| test_machines.py | machine that was taken over | all that its components and role do not need |
| test_hostile_machine.py | machine that was taken over | noise, floods, lies on its own topics |
| test_other_users.py | other local user | sockets and files of a run |

A peer without rights is a program of any user on this computer: the deployment lets it connect
(`bus.allow_any_local_user`), but it does not know the secret of the run. Everything happens on
loopback and Unix sockets; sizes, counts and times are bounded, so that the computer survives.

Each test is a case. It passes if the attack is refused with the reason that the case names, within
5 s; on a busy computer, which proves nothing, a slow case is only named. At the end of a file the
robot still drives to a goal, without a collision, no process was restarted, and none has used more
than 500 MB. A table of all groups follows.

To add a case:

- a file: an entry in `HOSTILE` of `tests/hostile_files.py`, with a part of the reason;
- a request: a line in a table of `test_requests.py`;
- a message: a damage in `inputs.py`, which every input of the simulated robot then receives;
- anything else: a test in the file of its group, which asserts the reason.

Inputs and requests of new components of `deploy/sim.yaml` are attacked without further ado.
"""
