#!/bin/sh
# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
# Run a script with the first supported Python: $PYTHON if it is set, else python3, python3.12, python3.11.
seen=
for candidate in ${PYTHON:-python3 python3.12 python3.11}; do
    version=$("$candidate" -c 'import sys; print("%d.%d" % sys.version_info[:2])' 2>/dev/null) || continue
    case $version in
    3.11 | 3.12) exec "$candidate" "$@" ;;
    esac
    seen="$seen${seen:+, }$candidate is $version"
done
echo "posor set-up: needs Python 3.11 or 3.12 and found ${seen:-none} (looked for ${PYTHON:-python3, python3.12, python3.11});" \
    "install python3.12 with its venv module, or name one: make PYTHON=/path/to/python3.12." >&2
exit 1
