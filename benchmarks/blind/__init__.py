"""The blind check: does the diagnosis name causes planted in simulators that share no code with it?"""
