# SPDX-License-Identifier: Apache-2.0
"""The local web page: open a session, see where the model fails, try an effect, watch the error fall.

Needs the extra `workbench`; nothing on the robot's computer imports it. `desk` computes (in a process of its own, `worker`),
`versions` remembers what was kept, `figures` draws, `page` and the panels put it on the screen.
"""
