"""Paths, folders, texts, images and programs: the part of odak that touches the file system."""

from odak.tools._commands import (
    ALLOWED_COMMANDS,
    DANGEROUS_PATTERNS,
    shell_command,
    validate_shell_command,
)
from odak.tools._documents import (
    load_dictionary,
    read_text_file,
    save_dictionary,
    write_to_text_file,
)
from odak.tools._folders import (
    check_directory,
    convert_bytes,
    copy_file,
    list_directories,
    list_files,
    size_of_a_file,
)
from odak.tools._images import load_image, save_image
from odak.tools._paths import expanduser, get_base_filename, validate_cwd, validate_path
from odak.tools._resize import resize_image

__all__ = [
    "ALLOWED_COMMANDS",
    "DANGEROUS_PATTERNS",
    "check_directory",
    "convert_bytes",
    "copy_file",
    "expanduser",
    "get_base_filename",
    "list_directories",
    "list_files",
    "load_dictionary",
    "load_image",
    "read_text_file",
    "resize_image",
    "save_dictionary",
    "save_image",
    "shell_command",
    "size_of_a_file",
    "validate_cwd",
    "validate_path",
    "validate_shell_command",
    "write_to_text_file",
]
