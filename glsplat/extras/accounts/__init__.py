"""Accounts: users of a server by name, with the avatars and rooms that each may use (docs/deploying.md).

`users.Accounts` plugs into the server by `AccessConfig.accounts` (`glsplat serve --users FILE`); `glsplat users`
manages the file.
"""

REQUIRES = ()
