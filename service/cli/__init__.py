"""The command line ``rbps``: thin commands over the engine, with the service's JSON documents.

``commands`` declares what there is to type and imports nothing heavy, so that ``--help`` answers at
once; beside it a module of each command's name does the work.
"""
