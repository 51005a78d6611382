#!/bin/sh
# Copyright 2026 POSOR maintainers
# SPDX-License-Identifier: Apache-2.0
# Makes an authority, certificates of one year, and Dask's configuration for `reprocess --scheduler tls://...`:
#   make_dask_certificates.sh FOLDER
# Copy FOLDER, without authority.key, to every machine of the cluster under the same path, readable by its user only.
set -eu

if [ $# -ne 1 ] || [ -e "$1" ]; then
    echo "make_dask_certificates.sh: expected one folder that does not exist yet" >&2
    exit 2
fi
umask 077
mkdir "$1"
folder=$(cd "$1" && pwd)
cd "$folder"
key="-newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -nodes"
openssl req -x509 $key -days 365 -subj "/CN=POSOR authority" -keyout authority.key -out authority.pem
{
    echo "distributed:"
    echo "  comm:"
    echo "    require-encryption: true"
    echo "    tls:"
    echo "      ca-file: '$folder/authority.pem'"
} >dask.yaml
for part in scheduler worker client; do
    openssl req $key -subj "/CN=POSOR $part" -keyout "$part.key" -out "$part.csr"
    openssl x509 -req -days 365 -in "$part.csr" -CA authority.pem -CAkey authority.key -CAcreateserial \
        -out "$part.pem"
    echo "      $part: {cert: '$folder/$part.pem', key: '$folder/$part.key'}" >>dask.yaml
done
rm -f ./*.csr ./*.srl
