"""Runs a class of a file as a rig's application: python3 host.py FILE CLASS. rigor.Rig starts it for runs by the wall clock."""
import importlib.util
import os
import sys


def main():
    file, name = sys.argv[1:3]
    package = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
    # Not this folder, whose modules are a package's, but what holds it, and what the file itself would find.
    sys.path[0] = os.path.dirname(file)
    sys.path.append(package)
    import rigor_client
    spec = importlib.util.spec_from_file_location("rigor_application", file)
    module = importlib.util.module_from_spec(spec)
    sys.modules["rigor_application"] = module
    spec.loader.exec_module(module)
    rigor_client.run(getattr(module, name)())


if __name__ == "__main__":
    main()
