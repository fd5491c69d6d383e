# make demo        installs everything and runs the main job
# make test        installs everything, lints, checks types and runs all tests
# make check       the part of it that takes a minute: lint, format, types, and the tests that start no
#                  process, open no connection, run no foreign simulator (tests/purity.py) and are not
#                  marked `thorough`
# make test-ros2   runs the tests that need ROS 2, in an environment of its own with ROS 2 from PyPI
# make docs        builds the documentation into site/
# make test-rotorpy ranks the robots of examples/rotorpy_drone, as a lab that installs nufleet would
# make test-busy   runs the tests RUNS times, beside processes that keep the machine busy
PYTHON ?= $(shell command -v python3.11 || command -v python3)
# pip would compile the 20 000 modules that are installed one after the other.
PIP_INSTALL = .venv/bin/python -m pip install --quiet --disable-pip-version-check --no-compile -c constraints.txt
# Some packages hold files for other versions of Python, which do not compile; nothing imports those.
COMPILE_INSTALLED = .venv/bin/python -m compileall -q -j 0 .venv/lib >/dev/null || true
# Many tests wait for processes; three at a time keep two cores busy.
TEST_PROCESSES ?= 3
# Tools that the tests need and pip does not install: a software renderer for pictures of recordings,
# a real PostgreSQL server, networks that can be cut in two, and clocks that are wrong.
SYSTEM_PACKAGES = mesa-vulkan-drivers postgresql iproute2 libfaketime

# ROS 2 Kilted from PyPI: rclpy, Fast DDS and the messages that the driver speaks.
ROS2 = ros-rclpy==9.1.2 ros-rmw-fastrtps-cpp==9.3.3 ros-geometry-msgs==5.5.1 ros-nav-msgs==5.5.1 \
  ros-rosgraph-msgs==2.3.0 ros-sensor-msgs==5.5.1 ros-std-srvs==5.5.1 ros-trajectory-msgs==5.5.1

RUNS ?= 5
BURNERS ?= 4

# mypy takes one core for more than a minute, and tests leave one idle while they wait.
beside_types = .venv/bin/mypy & types=$$!; $(1); tests=$$?; wait $$types && exit $$tests

.PHONY: demo docs test test-busy test-ros2 test-rotorpy check lint style clean system-packages

demo: .venv/installed-demo
	.venv/bin/nufleet demo

test: .venv/installed-test system-packages style
	@echo "== types and tests"
	@$(call beside_types,.venv/bin/pytest -n $(TEST_PROCESSES) --dist loadfile)

# A busy loop ends when the shell of this recipe ends, for whatever reason.
test-busy: .venv/installed-test system-packages
	@for burner in $$(seq $(BURNERS)); do (while kill -0 $$$$ 2>/dev/null; do :; done) & done; \
	for run in $$(seq $(RUNS)); do \
	  echo "== run $$run of $(RUNS), beside $(BURNERS) busy loops"; \
	  .venv/bin/pytest -n $(TEST_PROCESSES) --dist loadfile || exit 1; \
	done

# In a folder of its own, whose names are those of our packages and of a module of Python. rotorpy
# brings ten packages and 158 MB, so that it is no dependency of the other tests.
test-rotorpy:
	rm -rf build/rotorpy && mkdir -p build/rotorpy/shared && touch build/rotorpy/shared/__init__.py build/rotorpy/types.py
	$(PYTHON) -m venv build/rotorpy/venv
	build/rotorpy/venv/bin/python -m pip install --quiet --disable-pip-version-check -c constraints.txt \
	  . ./examples/rotorpy_drone pytest
	cd build/rotorpy && . venv/bin/activate && export NUFLEET_STATE=state && \
	  pytest -q -p no:cacheprovider ../../examples/rotorpy_drone && \
	  nufleet robot check rotorpy_drone && \
	  nufleet plan rank --fleet ../../examples/rotorpy_drone/fleet.toml && \
	  nufleet rank --fleet ../../examples/rotorpy_drone/fleet.toml --no-rehearsal --json > ranked.json && \
	  python -P -c 'import json; assert json.load(open("ranked.json"))["selected"] == "heavy"'

# ROS 2 starts Python again with other library paths, so that it has an environment of its own; no
# other run of the tests selects those that need it (pyproject.toml).
test-ros2: .venv-ros2/installed
	@echo "== tests over ROS 2"
	.venv-ros2/bin/python -m pytest -m ros2 tests/ros2

.venv-ros2/installed: pyproject.toml constraints.txt
	@echo "== creating .venv-ros2 with ROS 2 and nufleet (once; some minutes)"
	$(PYTHON) -m venv .venv-ros2
	.venv-ros2/bin/python -m pip install --quiet --disable-pip-version-check -c constraints.txt \
	  -e . hypothesis psutil pytest $(ROS2)
	@touch $@

# The documentation, in site/; open site/index.html.
docs: .venv/installed-test
	NO_MKDOCS_2_WARNING=1 .venv/bin/mkdocs build --strict

check: .venv/installed-test style
	@echo "== types and pure tests"
	@$(call beside_types,.venv/bin/pytest --pure -m "not thorough" -n $(TEST_PROCESSES) --dist loadfile)

lint: style
	@echo "== types"
	.venv/bin/mypy

style: .venv/installed-test
	@echo "== lint, format and spelling"
	.venv/bin/ruff check .
	.venv/bin/ruff format --check .
	.venv/bin/codespell

.venv/bin/python:
	@echo "== creating .venv with $(PYTHON)"
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
	  || { echo "nufleet needs Python 3.11 or newer; name the interpreter with make PYTHON=..."; exit 2; }
	$(PYTHON) -m venv .venv

.venv/installed-demo: .venv/bin/python pyproject.toml constraints.txt
	@echo "== installing nufleet and its dependencies (once; a minute or two)"
	$(PIP_INSTALL) -e .
	@echo "== compiling the code (once)"
	@# What numba compiles takes one core as long as all else takes several.
	@($(COMPILE_INSTALLED)) & compiling=$$!; \
	.venv/bin/python -m compileall -q orchestrator robot_agent shared sims && \
	.venv/bin/python -c 'from nufleet.shared.gaussian_process.exact import warm_up; warm_up()'; \
	warmed=$$?; wait $$compiling; exit $$warmed
	@touch $@

.venv/installed-test: .venv/installed-demo
	@echo "== installing the dependencies of the tests, including simulators (once; some minutes)"
	$(PIP_INSTALL) -e '.[test,quadrotors,arms,learning,repository,logs,crazyflie,mavlink]'
	$(COMPILE_INSTALLED)
	@touch $@

.venv/installed-quadrotors: .venv/installed-demo
	@echo "== installing the simulator of the quadrotors, and torch (once; some minutes)"
	$(PIP_INSTALL) -e '.[quadrotors,learning]'
	$(COMPILE_INSTALLED)
	@touch $@

system-packages:
	@missing=; for package in $(SYSTEM_PACKAGES); do \
	  dpkg -s $$package >/dev/null 2>&1 || missing="$$missing $$package"; done; \
	if [ -n "$$missing" ]; then \
	  echo "== installing$$missing"; \
	  if [ "$$(id -u)" != 0 ]; then \
	    echo "the tests need these packages: sudo apt-get install --no-install-recommends$$missing"; exit 2; fi; \
	  apt-get update -qq && apt-get install -y -qq --no-install-recommends $$missing; fi

clean:
	rm -rf .venv .venv-ros2 .mypy_cache .ruff_cache .hypothesis
