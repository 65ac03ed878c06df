# Builds an ordinary ament_cmake package against ROS 2 installed from wheels.
#
# To be given as CMAKE_PROJECT_TOP_LEVEL_INCLUDES. Does nothing where ROS 2 is not from wheels, so
# that it may be given always.

foreach(candidate Python3_EXECUTABLE Python_EXECUTABLE PYTHON_EXECUTABLE)
  if(NOT ros_wheels_python AND ${candidate})
    set(ros_wheels_python "${${candidate}}")
  endif()
endforeach()
if(NOT ros_wheels_python)
  find_program(ros_wheels_python NAMES python3 python REQUIRED NO_CACHE)
endif()

# The wheels unpack lib/ and share/ into the prefix three levels above site-packages.
execute_process(
  COMMAND "${ros_wheels_python}" -c [[
from importlib.metadata import distribution
from pathlib import Path
distribution("ros-ament-package")
import ament_package
print(Path(ament_package.__file__).resolve().parents[4])
]]
  OUTPUT_VARIABLE ros_wheels_prefix
  OUTPUT_STRIP_TRAILING_WHITESPACE
  ERROR_QUIET
  RESULT_VARIABLE ros_wheels_missing)
if(ros_wheels_missing)
  if(SKBUILD)  # pip, which builds in an environment of its own unless told otherwise
    message(FATAL_ERROR "No wheels of ROS 2 in sight: pip install '.[ros]', "
      "then pip install --no-build-isolation ./msg_defs")
  endif()
  return()
endif()

set(Python3_EXECUTABLE "${ros_wheels_python}" CACHE FILEPATH "Python of the ROS wheels")
list(PREPEND CMAKE_PREFIX_PATH "${ros_wheels_prefix}")
# The generators look each other up in the ament index, which knows this variable only.
if(NOT "$ENV{AMENT_PREFIX_PATH}" STREQUAL "")
  set(ENV{AMENT_PREFIX_PATH} "${ros_wheels_prefix}:$ENV{AMENT_PREFIX_PATH}")
else()
  set(ENV{AMENT_PREFIX_PATH} "${ros_wheels_prefix}")
endif()

# The Python libraries of the message wheels carry include folders of the machine they were built
# on, and CMake refuses to generate for a folder that does not exist.
function(ros_wheels_drop_missing_includes)
  get_property(targets DIRECTORY PROPERTY IMPORTED_TARGETS)
  foreach(target IN LISTS targets)
    if(target MATCHES "__rosidl_generator_py$")
      get_target_property(folders ${target} INTERFACE_INCLUDE_DIRECTORIES)
      set(existing)
      foreach(folder IN LISTS folders)
        if(EXISTS "${folder}")
          list(APPEND existing "${folder}")
        endif()
      endforeach()
      set_target_properties(${target} PROPERTIES INTERFACE_INCLUDE_DIRECTORIES "${existing}")
    endif()
  endforeach()
endfunction()
cmake_language(DEFER DIRECTORY "${CMAKE_SOURCE_DIR}" CALL ros_wheels_drop_missing_includes)
