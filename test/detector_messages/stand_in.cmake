# Builds the package of messages beside this file, as another build of its own: in a workspace, a source package of that
# name keeps its targets to itself. Sets what find_package would have set.
function(stl_build_stand_in package)
  set(build ${CMAKE_BINARY_DIR}/detector_messages/${package})
  foreach(step
      "-S;${PROJECT_SOURCE_DIR}/test/detector_messages/${package};-B;${build};-G;${CMAKE_GENERATOR}"
      "--build;${build}")
    execute_process(
      COMMAND ${CMAKE_COMMAND} ${step} RESULT_VARIABLE failed OUTPUT_VARIABLE output ERROR_VARIABLE output)
    if(failed)
      message(FATAL_ERROR "the stand-in for ${package} cannot be built:\n${output}")
    endif()
  endforeach()
  set(${package}_FOUND TRUE PARENT_SCOPE)
  set(${package}_INCLUDE_DIRS ${build}/devel/include PARENT_SCOPE)
  # Beside find_package's: where its Python modules lie.
  set(stand_in_python ${stand_in_python}:${build}/devel/${CATKIN_GLOBAL_PYTHON_DESTINATION} PARENT_SCOPE)
endfunction()
